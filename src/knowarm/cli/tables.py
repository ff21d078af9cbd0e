"""Tables for the terminal, and the same values as JSON files."""

import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import Annotated, Any, Literal

from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text
from tyro.conf import arg

from knowarm.errors import UserError, printable
from knowarm.reading import write_json, writing

Values = dict[str, Any]
"""What a command prints, as JSON values."""
FilePath = Annotated[Path | None, arg(metavar="FILE")]
FolderPath = Annotated[Path | None, arg(metavar="DIR")]
"""Types of an optional file argument, such as ``--json``, and of a folder."""
UNLIMITED = 10_000  # width of tables that no terminal shows
MOST_NAMES = 12
"""Most names in a cell."""


@dataclass(frozen=True, kw_only=True)
class TableCommand:
    """Command that prints a result and writes the same values to a JSON file."""

    json: FilePath = None
    """Also write the result to this JSON file."""

    def run(self) -> Mapping[str, Any]:
        """Run the command; a file that cannot be written is found before the work begins."""
        check_output(self.json)
        values = self.result()
        write_json_table(self.json, values)
        return values

    def result(self) -> Mapping[str, Any]:
        """Do the work, print the result and return its values."""
        raise NotImplementedError


def print_meeting(meeting: Mapping[str, Sequence[str]]) -> None:
    """Print how a policy and a graph meet: `meeting` of the experiment's answers."""
    rows = []
    for what, names in meeting.items():
        listed = ", ".join(names[:MOST_NAMES])
        if len(names) > MOST_NAMES:
            listed += ", ..."
        rows.append([what, len(names), listed])
    print_table("Policy and graph", ["objects", "count", "names"], rows)


def print_table(
    title: str,
    columns: Sequence[str],
    rows: Iterable[Sequence[Any]],
) -> None:
    """Print a table; numbers are right-aligned, floats have three decimals, from 10 one.

    Cells wrap between words only, and not at all where they are a ``Text`` with ``no_wrap``.
    Columns for which the terminal is too narrow follow in further
    tables, each with the first column. Without a terminal a table is as wide as its content.
    """
    console = make_console()
    console.print(Text(printable(title), style="bold"), soft_wrap=True)
    for table in lay_out(columns, [list(row) for row in rows], console.width):
        console.print(table, crop=False)


def lay_out(
    columns: Sequence[str],
    rows: Sequence[Sequence[Any]],
    room: int,
) -> list[Table]:
    """Return tables of at most ``room`` characters that show all columns; see `print_table`."""
    laid_out = []
    for i, name in enumerate(columns):
        laid_out.append(_Column(name, [row[i] for row in rows]))
    tables = []
    for block in _blocks(laid_out, room):
        table = Table(width=_share(block, room))
        for column in block:
            table.add_column(column.heading, justify=column.justify, width=column.width)
        for i in range(len(rows)):
            table.add_row(*[column.cells[i] for column in block])
        tables.append(table)
    return tables


class _Column:
    """Heading and cells of a column, and how many characters wide they are."""

    def __init__(self, name: str, values: Sequence[Any]):
        self.heading = Text(printable(name))
        self.cells = list(map(_cell, values))
        texts = [self.heading, *self.cells]
        self.least = max(map(_longest_part, texts))
        self.wish = max(text.cell_len for text in texts) - self.least
        self.width = self.least
        self.justify: Literal["left", "right"] = "left"
        if values and all(isinstance(value, int | float) for value in values):
            self.justify = "right"


def _longest_part(cell: Text) -> int:
    """Return the width of the longest part of a cell that must stay on one line."""
    parts = [cell.plain] if cell.no_wrap else cell.plain.split()
    return max(map(cell_len, parts), default=0)


def _blocks(columns: list[_Column], room: int) -> list[list[_Column]]:
    """Split columns into as few tables as possible, each with the first column."""
    first, *others = columns
    blocks = [columns]
    for count in range(1, len(columns)):
        size = -(-len(others) // count)
        starts = range(0, len(others), size)
        blocks = [[first, *others[start : start + size]] for start in starts]
        if max(map(_width, blocks)) <= room:
            break
    return blocks


def _width(columns: Sequence[_Column]) -> int:
    """Return the width of a table with frame and padding."""
    return sum(column.width + 3 for column in columns) + 1


def _share(columns: Sequence[_Column], room: int) -> int:
    """Share the room among columns, those with the shortest lines first; return the width."""
    for column in columns:
        column.width = column.least  # the first may have been in another table
    spare = room - _width(columns)
    waiting = len(columns)
    for column in sorted(columns, key=lambda column: column.wish):
        more = max(0, min(column.wish, spare // waiting))
        column.width += more
        spare -= more
        waiting -= 1
    return _width(columns)


def counted(count: int, noun: str) -> str:
    """Return a number and its noun, in the plural but for 1."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def make_console() -> Console:
    """Return a console as wide as the terminal, or as ``COLUMNS`` says, or without limit.

    It takes no markup: what it prints may hold names that look like some.
    """
    width = None if is_terminal() or "COLUMNS" in os.environ else UNLIMITED
    return _Console(highlight=False, markup=False, emoji=False, width=width)


def is_terminal() -> bool:
    """Return whether a person reads the output; there may be none (``>&-``)."""
    return sys.stdout is not None and sys.stdout.isatty()


class _Console(Console):
    """Console that leaves a closed pipe to `main`."""

    def on_broken_pipe(self) -> None:
        """Raise the error again."""
        raise BrokenPipeError


def _cell(value: Any) -> Text:
    """Return a value as the text of a cell."""
    if isinstance(value, Text):
        return value
    text = printable(str(value))
    if value is None:
        text = "-"
    elif isinstance(value, bool):
        text = "yes" if value else "no"
    elif isinstance(value, int):
        text = f"{value:,}"
    elif isinstance(value, float):
        digits = 3 if abs(value) < 10 else 1
        if abs(value) >= 1000:
            digits = 0
        text = f"{value:,.{digits}f}"
    return Text(text)


def check_output(path: Path | None, option: str = "--json") -> None:
    """Check that the file of an option can be written, before the work whose result it holds."""
    if path is None:
        return
    with writing(path, f"Choose another path for {option}."):
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists() and not path.is_file():
            path.open(
                "a", encoding="utf-8"
            ).close()  # a device, or an error of the system
        else:
            TemporaryFile(dir=path.parent).close()


def check_out(path: Path | None, what: str, suffixes: Sequence[str]) -> None:
    """Refuse an output file of another type before the work whose result it will hold."""
    if path is not None and path.suffix not in suffixes:
        raise UserError(f"--out {path}: {what} are written as {', '.join(suffixes)}.")
    check_output(path, "--out")


def write_json_table(path: Path | None, values: Mapping[str, Any]) -> None:
    """Write the values of tables to a JSON file; None writes nothing."""
    if path is not None:
        write_json(path, values)
        print(f"Wrote {path}")
