"""Building blocks of a report page: text, verdicts, figures, films, tables."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from knowarm.experiment.summary import find_measure
from knowarm.reading import read_toml
from knowarm.report.model import Evaluated, Reference, StudyData, TaskData
from knowarm.statistics import Interval

Row = dict[str, Any]
TABLES: Row = read_toml(Path(__file__).with_name("tables.toml"))


@dataclass(frozen=True)
class Column:
    """One column of a table."""

    key: str  # name in the rows and in the CSV
    label: str  # heading, with the unit
    format: str = "text"  # key of `format.FORMATS`
    interval: bool = False  # whether values may be intervals, whose ends are shown, too
    hint: str = ""  # explanation of the heading, one sentence


@dataclass(frozen=True)
class DataTable:
    """Rows under named columns; written as CSV beside the report."""

    name: str  # stem of the CSV file; unique in a report
    title: str
    columns: Sequence[Column]  # columns, left to right
    # Values and intervals; ``_colour`` holds the palette class of a row. Of rows that a figure
    # draws, ``_panel`` is the title of the drawing, ``_agent`` an `Evaluated`, ``_name`` its name.
    rows: Sequence[Row]
    sources: Sequence[Path] = ()  # run folders that the numbers were computed from
    note: str = ""  # how the numbers were computed and what they do not show
    caption: str = ""  # how to read the drawings of its numbers

    @property
    def flat_rows(self) -> list[Row]:
        """Rows in which an interval is ``<key>``, ``<key>_low``, ``<key>_high`` and ``_runs``."""
        rows = []
        for row in self.rows:
            flat_row = dict(row)
            for key, value in row.items():
                if isinstance(value, Interval):
                    flat_row |= value.named(key)
                    flat_row[f"{key}_runs"] = value.runs
            rows.append(flat_row)
        return rows

    def csv_columns(self) -> list[str]:
        """Return the names of the CSV's columns, in order."""
        names = []
        for column in self.columns:
            names.append(column.key)
            if column.interval:
                names += [f"{column.key}_low", f"{column.key}_high"]
        return names


def table_of(
    of: TaskData | StudyData,
    name: str,
    rows: Sequence[Row],
    *,
    like: str = "",
    more: Iterable[str | Column] = (),
    stem: str = "",
    **words: str,
) -> DataTable:
    """Return a table of a task or study as ``tables.toml`` describes it.

    Args:
        of: the task, in whose name that of the CSV file ends, or the study.
        name: of the table in ``tables.toml``, unless ``like`` is.
        rows: of the table.
        like: the table of which this is one of several.
        more: columns after those of ``tables.toml``.
        stem: the end of the name of the CSV file.
        words: for the names in braces.
    """
    table = TABLES[like or name]
    columns = [_column(column, words) for column in (*table["columns"], *more)]
    title, note, caption = [
        table.get(part, "").format(**words).strip()
        for part in ("title", "note", "caption")
    ]
    name = "-".join(filter(None, (name, of.name, stem)))
    sources = [run.path for run in of.runs]
    return DataTable(
        name=name,
        title=title,
        columns=columns,
        rows=rows,
        sources=sources,
        note=note,
        caption=caption,
    )


def _column(column: str | Row | Column, words: Mapping[str, str]) -> Column:
    if isinstance(column, Column):
        return column
    changes = {"key": column} if isinstance(column, str) else column
    key = changes["key"]
    measure = find_measure(key)
    fields: Row = {"label": key}
    if key in TABLES["columns"]:
        fields |= TABLES["columns"][key]
    elif measure:
        fields = {"label": measure.title, "hint": measure.about, "interval": True}
        fields["format"] = measure.format
    fields |= changes
    for field in ("label", "hint"):
        fields[field] = fields.get(field, "").format(**words)
    return Column(**fields)


def row_of(evaluated: Evaluated, *keys: str) -> Row:
    """Return the row of an agent: its name, seeds and colour, and numbers of its summary."""
    row: Row = {key: evaluated.level(key) for key in keys}
    row["agent"] = evaluated.name
    row["_agent"] = evaluated
    row["_colour"] = evaluated.colour
    if not isinstance(evaluated, Reference):
        row["seeds"] = len(evaluated.evaluations)
    return row


Tone = Literal["good", "bad", "open", "note"]
"""Confirmed, refuted, undecided, or a remark."""


@dataclass(frozen=True)
class Panel:
    """One drawing of a figure."""

    svg: str  # markup of one ``<svg>``
    title: str = ""  # heading above the drawing
    # Screens it is for, where it has two widths.
    only: Literal["", "large", "small"] = ""


@dataclass(frozen=True)
class Figure:
    """Drawings with a table of the values they show."""

    table: DataTable  # the drawn values; its title is the figure's
    panels: Sequence[Panel]  # drawings, side by side where there is room
    # Names, which toggle their series, and classes.
    legend: Sequence[tuple[str, str]] = ()
    open_table: bool = False  # whether the table is above the drawings, not folded


@dataclass(frozen=True)
class Text:
    """Paragraphs of plain text."""

    paragraphs: Sequence[str]


@dataclass(frozen=True)
class Verdict:
    """A statement derived from the numbers."""

    sentence: str  # the statement
    reasons: Sequence[str] = ()  # what it follows from, one sentence each
    shown_reasons: int = 99  # reasons shown at first; the others are folded
    tone: Tone = "note"  # how it is coloured
    kind: str = ""  # one of `claims.KINDS`, for programs; "" for other statements


@dataclass(frozen=True)
class Film:
    """One episode of one agent: selected frames and the animation."""

    name: str
    # Data URI of a PNG and its label, per selected step.
    strip: Sequence[tuple[str, str]]
    moving: str  # data URI of the animated WebP
    poster: str  # data URI of the last frame
    size: tuple[int, int]  # width and height of a frame [px]
    episode: Row  # its row of ``episodes.parquet``, which tells how it ended
    colour: str = ""  # palette class


@dataclass(frozen=True)
class Films:
    """Several agents on the same episode."""

    title: str
    films: Sequence[Film]


@dataclass(frozen=True, kw_only=True)
class TaskPart:
    """The blocks of one task, with its name and title; the page shows the selected task."""

    name: str
    title: str
    blocks: Sequence["Block"]


@dataclass(frozen=True, kw_only=True)
class Folded:
    """Blocks that are hidden until their title is clicked."""

    title: str
    blocks: Sequence["Block"]


Block = Text | Verdict | DataTable | Figure | Films | TaskPart | Folded


def flat(blocks: Sequence[Block]) -> list[Block]:
    """Return blocks in reading order, with nested ones unfolded."""
    unfolded: list[Block] = []
    for block in blocks:
        if isinstance(block, TaskPart | Folded):
            unfolded += flat(block.blocks)
        else:
            unfolded.append(block)
    return unfolded


@dataclass(frozen=True)
class Page:
    """One section of the report."""

    name: str  # anchor in the address; capitalized, name in the navigation
    title: str
    lead: str  # one sentence under the heading
    blocks: Sequence[Block]  # content
