"""Pages go in; one CSV a table, and one JSON with all of them, come out."""

import csv
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import knowarm
from knowarm.errors import UserError
from knowarm.experiment.run_folder import write_json
from knowarm.report.blocks import Page, Table, Verdict, flat
from knowarm.report.study import Study

DIGITS = 9
"""Significant digits of every written number."""

FORMAT = 1
"""Version of ``report.json``."""


def data_folder(out: Path) -> Path:
    """Folder of the CSVs of a report."""
    return out.with_name(f"{out.stem}-data")


def write_data(study: Study, pages: Sequence[Page], out: Path) -> None:
    """Write the numbers of a report for people's own plots; paths are relative to the page.

    Args:
        study: what the pages were made from.
        pages: the pages.
        out: the HTML file they stand beside.

    Raises:
        UserError: the place cannot be written to.
    """
    folder = data_folder(out)
    tables = [table for page in pages for table in page.tables()]
    names = [table.name for table in tables]
    assert len(set(names)) == len(names), f"two tables of one name: {names}"
    try:
        folder.mkdir(exist_ok=True)
        for old in folder.glob("*.csv"):
            old.unlink()
        for table in tables:
            _write_csv(folder / f"{table.name}.csv", table, out.parent)
    except OSError as error:
        raise UserError(f"Cannot write {folder}: {error.strerror}.") from error
    write_json(
        out.with_suffix(".json"),
        {
            "format": FORMAT,
            "knowarm": knowarm.__version__,
            "tasks": [task.title for task in study.tasks],
            "runs": [relative(run.path, out.parent) for run in study.runs],
            "problems": [
                {"path": relative(each.path, out.parent), "what": each.what, "done": each.done}
                for each in study.problems
            ],
            "verdicts": [
                {"page": page.name, "sentence": block.sentence, "reasons": list(block.reasons)}
                for page in pages
                for block in flat(page.blocks)
                if isinstance(block, Verdict)
            ],
            "tables": {
                table.name: {
                    "title": table.title,
                    "note": table.note,
                    "csv": f"{folder.name}/{table.name}.csv",
                    "sources": [relative(path, out.parent) for path in table.sources],
                    "rows": [_plain_row(table, row, out.parent) for row in table.rows],
                }
                for table in tables
            },
        },
    )


def raw(value: Any, start: Path) -> str:
    """A value as the CSV and the page's ``data-v`` attributes have it."""
    plain = _plain(value, start)
    return "" if plain is None else repr(plain) if isinstance(plain, float) else str(plain)


def relative(path: Path, start: Path) -> str:
    """A path as seen from the page, with forward slashes."""
    return Path(os.path.relpath(path, start)).as_posix()


def _write_csv(path: Path, table: Table, start: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(table.csv_columns())
        for row in table.rows:
            writer.writerow([raw(row.get(key), start) for key in table.csv_columns()])


def _plain_row(table: Table, row: dict[str, Any], start: Path) -> dict[str, Any]:
    return {key: _plain(row.get(key), start) for key in table.csv_columns()}


def _plain(value: Any, start: Path) -> Any:
    if isinstance(value, Path):
        return relative(value, start)
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
    return value
