"""Building blocks of a report page: text, verdicts, figures, films."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

from knowarm.report.tables import DataTable

Tone = Literal["good", "bad", "open", "note"]  # confirmed, refuted, undecided, or a remark


@dataclass(frozen=True, kw_only=True)
class Panel:
    """One drawing of a figure."""

    svg: str  # markup of one ``<svg>``
    title: str = ""  # heading above the drawing
    only: Literal["", "large", "small"] = ""  # screens it is for, where it has two widths


@dataclass(frozen=True, kw_only=True)
class Figure:
    """Drawings with a table of the values they show."""

    table: DataTable  # the drawn values; its title is the figure's
    caption: str  # how to read the drawings
    panels: Sequence[Panel]  # drawings, side by side where there is room
    legend: Sequence[tuple[str, str]] = ()  # names, which toggle their series, and classes
    open_table: bool = False  # whether the table is expanded at first


@dataclass(frozen=True, kw_only=True)
class Text:
    """Paragraphs of plain text."""

    paragraphs: Sequence[str]


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """A statement derived from the numbers."""

    sentence: str  # the statement
    reasons: Sequence[str] = ()  # what it follows from, one sentence each
    shown_reasons: int = 99  # reasons shown at first; the others are folded
    tone: Tone = "note"  # how it is coloured
    kind: str = ""  # one of `finding.Kind`, for programs; "" for other statements


class Tile(NamedTuple):
    """One large number with its label, a detail in small type and a palette class."""

    label: str
    value: str
    detail: str
    colour: str


@dataclass(frozen=True, kw_only=True)
class Tiles:
    """Large numbers side by side."""

    tiles: Sequence[Tile]


@dataclass(frozen=True, kw_only=True)
class Film:
    """One episode of one agent: selected frames and the animation."""

    name: str
    strip: Sequence[tuple[str, str]]  # data URI of a PNG and its label, per selected step
    moving: str  # data URI of the animated WebP
    poster: str  # data URI of the last frame
    size: tuple[int, int]  # width and height of a frame [px]
    text: str  # outcome of the episode, also the text alternative
    colour: str = ""  # palette class


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
class TaskPart:
    """The blocks of one task, with its name and title; the page shows the selected task."""

    name: str
    title: str
    blocks: Sequence["Block"]


Block = Text | Verdict | Tiles | DataTable | Figure | Films | Pair | TaskPart


def flat(blocks: Sequence[Block]) -> list[Block]:
    """Return blocks in reading order, with nested ones unfolded."""
    found: list[Block] = []
    for block in blocks:
        if isinstance(block, Pair):
            found += flat([*block.left, *block.right])
        elif isinstance(block, TaskPart):
            found += flat(block.blocks)
        else:
            found.append(block)
    return found


@dataclass(frozen=True, kw_only=True)
class Page:
    """One section of the report."""

    name: str  # anchor in the address; capitalized, name in the navigation
    title: str
    lead: str  # one sentence under the heading
    blocks: Sequence[Block]  # content

    def tables(self) -> list[DataTable]:
        """Return every table of the page, including those of figures."""
        shown = [block for block in flat(self.blocks) if isinstance(block, DataTable | Figure)]
        return [block.table if isinstance(block, Figure) else block for block in shown]
