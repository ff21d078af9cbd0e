"""Tables of a report: columns, rows, and the files that their numbers come from."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from knowarm.report.model import Evaluated, Reference, TaskData
from knowarm.statistics import Interval

Row = dict[str, Any]


@dataclass(frozen=True)
class Column:
    """One column of a table."""

    key: str  # name in the rows and in the CSV
    label: str  # heading, with the unit
    format: str = "text"  # key of `format.FORMATS`
    interval: bool = False  # whether the rows also hold ``<key>_low`` and ``<key>_high``
    hint: str = ""  # explanation of the heading, one sentence


_SHARED = (
    *(Column(key, key, "integer") for key in ("seed", "episodes", "parameters")),
    Column("seeds", "seeds", "integer", hint="training seeds"),
    Column("return_mean", "mean return", "number1", interval=True),
    *(Column(key, key, "percent", interval=True) for key in ("success", "accuracy")),
    Column("choice", "right choices", "percent", interval=True),
)
SHARED = {column.key: column for column in _SHARED}  # columns of several tables


def cells(key: str, interval: Interval | None) -> Row:
    """Return the three cells of a table row that hold an interval."""
    if interval is None:
        return {key: None, f"{key}_low": None, f"{key}_high": None}
    return {key: interval.estimate, f"{key}_low": interval.low, f"{key}_high": interval.high}


@dataclass(frozen=True, kw_only=True)
class DataTable:
    """Rows under named columns; written as CSV beside the report."""

    name: str  # stem of the CSV file; unique in a report
    title: str
    columns: Sequence[Column]  # columns, left to right
    rows: Sequence[Row]  # values before formatting; ``_colour`` holds the palette class of a row
    sources: Sequence[Path] = ()  # files and folders that the numbers were computed from
    note: str = ""  # how the numbers were computed and what they do not show

    def csv_columns(self) -> list[str]:
        """Return the names of the CSV's columns, in order."""
        ends = {False: ("",), True: ("", "_low", "_high")}
        return [f"{column.key}{end}" for column in self.columns for end in ends[column.interval]]


def table_of(
    task: TaskData,
    name: str,
    title: str,
    columns: Iterable[str | Column],
    rows: Sequence[Row],
    sources: Sequence[Path] | None = None,
    note: str = "",
    stem: str = "",
) -> DataTable:
    """Return a table of one task, with columns as in `shared`, name and title ending in the task's.

    ``sources`` of None are all run folders of the task; ``stem`` ends the name of the CSV file.
    """
    return DataTable(
        name=f"{name}-{task.name}{stem}",
        title=f"{title}: {task.title}",
        columns=shared(*columns),
        rows=rows,
        sources=[run.path for run in task.runs] if sources is None else sources,
        note=note,
    )


def shared(*columns: str | Column) -> list[Column]:
    """Return columns, given as they are, by their key in `SHARED`, or by the name of a text."""
    found = (SHARED.get(c) or Column(c, c) if isinstance(c, str) else c for c in columns)
    return list(found)


def row_of(task: TaskData, each: Evaluated, *keys: str) -> Row:
    """Return the row of an agent: its name, seeds and colour, and numbers of its summary."""
    seeds = None if isinstance(each, Reference) else len(each.evaluations)
    row: Row = {"agent": each.name, "seeds": seeds, "_colour": task.colours[each.name]}
    for key in keys:
        row |= cells(key, each.level(key))
    return row
