"""Tables for the terminal, and the same values as JSON files."""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.table import Table

from knowarm.errors import UserError

FilePath = Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")]
"""Type of an optional file argument, such as ``--json``."""


def print_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Print a table; numbers are right-aligned, floats below 1,000 have three decimals."""
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
    """Check that a JSON file can be written, before the work whose result it will hold.

    Raises:
        UserError: the folder of the file cannot be created or written to.
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
            f"Cannot write the JSON file {path}: {error.strerror}. Choose another path for --json."
        ) from error


def write_json_table(path: Path | None, values: Mapping[str, Any]) -> None:
    """Write the values of a printed table to a JSON file, if there is a path."""
    if path is not None:
        path.write_text(json.dumps(values, indent=2) + "\n")
        print(f"Wrote {path}")
