"""Nothing goes in; the few kinds of things a page is made of come out."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from knowarm.report.study import Task

Row = dict[str, Any]

Tone = Literal["good", "bad", "open", "note"]
"""Shown, refuted, undecided, or a remark."""


@dataclass(frozen=True, kw_only=True)
class Column:
    """One column of a table."""

    key: str
    """Name in the rows and in the CSV."""

    label: str
    """Heading, with the unit."""

    format: str = "text"
    """Key of `format.FORMATS`."""

    interval: bool = False
    """Whether the rows also hold ``<key>_low`` and ``<key>_high``."""

    hint: str = ""
    """What the heading means, in one sentence."""


@dataclass(frozen=True, kw_only=True)
class Table:
    """Rows under named columns; written as CSV beside the page."""

    name: str
    """Stem of the CSV file; unique in a report."""

    title: str
    """What the rows are."""

    columns: Sequence[Column]
    """Columns, left to right."""

    rows: Sequence[Row]
    """Raw values, not yet formatted; text in ``_colour`` names the row's palette class."""

    sources: Sequence[Path] = ()
    """Files and folders every number was computed from."""

    note: str = ""
    """How the numbers were made and what they do not show."""

    def csv_columns(self) -> list[str]:
        """Names of the CSV's columns, in order."""
        keys = []
        for column in self.columns:
            keys += [column.key]
            if column.interval:
                keys += [f"{column.key}_low", f"{column.key}_high"]
        return keys


@dataclass(frozen=True, kw_only=True)
class Panel:
    """One drawing of a figure."""

    svg: str
    """Markup of one ``<svg>``."""

    title: str = ""
    """Heading above the drawing."""

    only: Literal["", "wide", "narrow"] = ""
    """Screens the drawing is meant for: the same drawing may come in two widths."""


@dataclass(frozen=True, kw_only=True)
class Figure:
    """Drawings with the table of everything they show."""

    title: str
    """Heading: what one sees."""

    caption: str
    """How to read it."""

    panels: Sequence[Panel]
    """Drawings, shown side by side where there is room."""

    table: Table
    """The drawn values, for those who cannot see the drawing."""

    legend: Sequence[tuple[str, str]] = ()
    """Pairs of name and palette class; names can be switched off and on."""

    open_table: bool = False
    """Whether the table is shown without being asked for."""


@dataclass(frozen=True, kw_only=True)
class Text:
    """Paragraphs."""

    paragraphs: Sequence[str]
    """Plain text."""

    heading: str = ""
    """Heading above them."""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """A sentence that follows from the numbers, with what it rests on."""

    sentence: str
    """The statement."""

    reasons: Sequence[str] = ()
    """What it follows from, a sentence each."""

    shown_reasons: int = 99
    """Reasons that are seen at once; the others on request."""

    tone: Tone = "note"
    """How it is coloured."""


@dataclass(frozen=True, kw_only=True)
class Tile:
    """One large number."""

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
    """One episode of one agent: a strip of images, and the moving images."""

    name: str
    strip: Sequence[tuple[str, str]]
    """Chosen steps: data URI of a PNG, and what to write under it."""

    moving: str
    """Data URI of the animated WebP."""

    poster: str
    """Data URI of its last image."""

    size: tuple[int, int]
    """Width and height of one image [px]."""

    text: str
    """What happens, for those who cannot see it."""

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
    """The blocks of one task; where there are several tasks, one is looked at at a time."""

    name: str
    """Name of the task."""

    title: str
    """Title of the task."""

    blocks: Sequence["Block"]


Block = Text | Verdict | Tiles | Table | Figure | Films | Pair | Part


def flat(blocks: Sequence[Block]) -> list[Block]:
    """Blocks in reading order, those in columns too."""
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
    """One section of the report."""

    name: str
    """Anchor in the address."""

    short: str
    """Name in the navigation."""

    title: str
    """Heading."""

    lead: str = ""
    """One sentence under the title."""

    blocks: list[Block] = field(default_factory=list)

    def add(self, task: Task, blocks: Sequence[Block]) -> None:
        """Add the blocks of one task, if there are any."""
        if blocks:
            self.blocks.append(Part(name=task.name, title=task.title, blocks=blocks))

    def tables(self) -> list[Table]:
        """Every table of the page, those under figures too."""
        shown = [block for block in flat(self.blocks) if isinstance(block, Table | Figure)]
        return [block.table if isinstance(block, Figure) else block for block in shown]
