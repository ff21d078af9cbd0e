"""Building blocks of a report page: text, verdicts, tables, figures, films."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from knowarm.statistics import Interval

Row = dict[str, Any]

Tone = Literal["good", "bad", "open", "note"]
"""Confirmed, refuted, undecided, or a remark."""


@dataclass(frozen=True)
class Column:
    """One column of a table.

    Attributes:
        key: name in the rows and in the CSV.
        label: heading, with the unit.
        format: key of `format.FORMATS`.
        interval: whether the rows also hold ``<key>_low`` and ``<key>_high``.
        hint: explanation of the heading, one sentence.
    """

    key: str
    label: str
    format: str = "text"
    interval: bool = False
    hint: str = ""


SHARED = {
    "task": Column("task", "task"),
    "agent": Column("agent", "agent"),
    "seed": Column("seed", "seed", "integer"),
    "seeds": Column("seeds", "seeds", "integer", hint="training seeds"),
    "return_mean": Column("return_mean", "mean return", "number1", interval=True),
    "success": Column("success", "success", "percent", interval=True),
    "accuracy": Column("accuracy", "accuracy", "percent", interval=True),
    "split": Column("split", "split"),
    "choice": Column("choice", "right choices", "percent", interval=True),
}
"""Columns of several tables, by key."""


def shared(*keys: str) -> list[Column]:
    """Return columns of `SHARED`."""
    return [SHARED[key] for key in keys]


def cells(key: str, interval: Interval | None) -> Row:
    """Return the three cells of a table row that hold an interval."""
    if interval is None:
        return {key: None, f"{key}_low": None, f"{key}_high": None}
    return {key: interval.estimate, f"{key}_low": interval.low, f"{key}_high": interval.high}


@dataclass(frozen=True, kw_only=True)
class Table:
    """Rows under named columns; written as CSV beside the report.

    Attributes:
        name: stem of the CSV file; unique in a report.
        title: heading.
        columns: columns, left to right.
        rows: values before formatting; ``_colour`` holds the palette class of a row.
        sources: files and folders that the numbers were computed from.
        note: how the numbers were computed and what they do not show.
    """

    name: str
    title: str
    columns: Sequence[Column]
    rows: Sequence[Row]
    sources: Sequence[Path] = ()
    note: str = ""

    def csv_columns(self) -> list[str]:
        """Return the names of the CSV's columns, in order."""
        keys = []
        for column in self.columns:
            ends = ("", "_low", "_high") if column.interval else ("",)
            keys += [f"{column.key}{end}" for end in ends]
        return keys


@dataclass(frozen=True, kw_only=True)
class Panel:
    """One drawing of a figure.

    Attributes:
        svg: markup of one ``<svg>``.
        title: heading above the drawing.
        only: screens the drawing is meant for, where it comes in two widths.
    """

    svg: str
    title: str = ""
    only: Literal["", "large", "small"] = ""


@dataclass(frozen=True, kw_only=True)
class Figure:
    """Drawings with a table of the values they show.

    Attributes:
        title: heading.
        caption: how to read the drawings.
        panels: drawings, side by side where there is room.
        table: the drawn values.
        legend: pairs of name and palette class; each name toggles its series.
        open_table: whether the table is expanded at first.
    """

    title: str
    caption: str
    panels: Sequence[Panel]
    table: Table
    legend: Sequence[tuple[str, str]] = ()
    open_table: bool = False


@dataclass(frozen=True, kw_only=True)
class Text:
    """Paragraphs of plain text."""

    paragraphs: Sequence[str]


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """A statement derived from the numbers.

    Attributes:
        sentence: the statement.
        reasons: what it follows from, one sentence each.
        shown_reasons: reasons shown at first; the others are folded.
        tone: how it is coloured.
        kind: one of `verdict.Kind`, for programs; "" for other statements.
    """

    sentence: str
    reasons: Sequence[str] = ()
    shown_reasons: int = 99
    tone: Tone = "note"
    kind: str = ""


@dataclass(frozen=True, kw_only=True)
class Tile:
    """One large number with its label, a detail in small type and a palette class."""

    label: str
    value: str
    detail: str = ""
    colour: str = ""


@dataclass(frozen=True, kw_only=True)
class Tiles:
    """Large numbers side by side."""

    tiles: Sequence[Tile]


@dataclass(frozen=True, kw_only=True)
class Film:
    """One episode of one agent: selected frames and the animation.

    Attributes:
        name: name of the agent.
        strip: data URI of a PNG and its label, per selected step.
        moving: data URI of the animated WebP.
        poster: data URI of the last frame.
        size: width and height of a frame [px].
        text: outcome of the episode, also the text alternative.
        colour: palette class.
    """

    name: str
    strip: Sequence[tuple[str, str]]
    moving: str
    poster: str
    size: tuple[int, int]
    text: str
    colour: str = ""


@dataclass(frozen=True, kw_only=True)
class Films:
    """Several agents on the same episode."""

    title: str
    films: Sequence[Film]


@dataclass(frozen=True, kw_only=True)
class Pair:
    """Blocks in two columns where there is room."""

    left: Sequence["Block"]
    right: Sequence["Block"]


@dataclass(frozen=True, kw_only=True)
class Part:
    """The blocks of one task, with its name and title; the page shows the selected task."""

    name: str
    title: str
    blocks: Sequence["Block"]


Block = Text | Verdict | Tiles | Table | Figure | Films | Pair | Part


def flat(blocks: Sequence[Block]) -> list[Block]:
    """Return blocks in reading order, with nested ones unfolded."""
    found: list[Block] = []
    for block in blocks:
        if isinstance(block, Pair):
            found += flat([*block.left, *block.right])
        elif isinstance(block, Part):
            found += flat(block.blocks)
        else:
            found.append(block)
    return found


@dataclass(frozen=True, kw_only=True)
class Page:
    """One section of the report.

    Attributes:
        name: anchor in the address; capitalized, name in the navigation.
        title: heading.
        lead: one sentence under the heading.
        blocks: content.
    """

    name: str
    title: str
    lead: str
    blocks: Sequence[Block]

    def tables(self) -> list[Table]:
        """Return every table of the page, including those of figures."""
        shown = [block for block in flat(self.blocks) if isinstance(block, Table | Figure)]
        return [block.table if isinstance(block, Figure) else block for block in shown]
