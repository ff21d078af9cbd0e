"""Rows go in; a table on the terminal, and the same values as JSON, come out."""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from knowarm.errors import UserError


def print_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Print a table; numbers are right-aligned, floats below 1,000 get three decimals."""
    rows = [list(row) for row in rows]
    table = Table(title=title, title_justify="left", title_style="bold")
    for i, name in enumerate(columns):
        numeric = bool(rows) and all(isinstance(row[i], int | float) for row in rows)
        table.add_column(name, justify="right" if numeric else "left", overflow="fold")
    for row in rows:
        table.add_row(*[_cell(value) for value in row])
    Console(highlight=False).print(table)


def _cell(value: Any) -> str:
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "-"}[value]
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, float):
        return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:,.3f}"
    return str(value)


def check_json_path(path: Path | None) -> None:
    """Find out before the work, not after it, that the JSON file cannot be written.

    Raises:
        UserError: the folder of the file does not exist or cannot be written to.
    """
    if path is None:
        return
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        is_new = not path.exists()
        path.open("a").close()
        if is_new:
            path.unlink()
    except OSError as error:
        raise UserError(
            f"Cannot write the JSON file {path}: {error.strerror}. Give --json another place."
        ) from error


def write_json_table(path: Path | None, values: Mapping[str, Any]) -> None:
    """Write the values of a printed table as JSON, when a file was asked for."""
    if path is not None:
        path.write_text(json.dumps(values, indent=2) + "\n")
        print(f"Wrote {path}")
