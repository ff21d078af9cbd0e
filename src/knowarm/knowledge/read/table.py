"""A CSV or TSV file with head, relation, tail columns goes in; a KnowledgeGraph comes out."""

import csv
from collections.abc import Iterator
from pathlib import Path

from knowarm.errors import UserError
from knowarm.knowledge.builder import GraphBuilder
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.read.label_choice import LabelChoice
from knowarm.knowledge.read.lines import MAX_LINE, decode, line_blocks, open_bytes

HEADERS = (("head", "relation", "tail"), ("h", "r", "t"), ("subject", "predicate", "object"))
"""First lines that name the columns and are no triple."""


def read_table(path: Path, separator: str) -> KnowledgeGraph:
    """Read a table of names; a first line such as `head,relation,tail` is left out.

    CSV follows RFC 4180 (quotes may hold commas and line ends); in TSV every character counts.

    Raises:
        UserError: a line has not three columns or an empty one; it is named.
    """
    builder, labels = GraphBuilder(), LabelChoice()
    rows = _tab_rows(path) if separator == "\t" else _csv_rows(path, separator)
    for number, row in rows:
        if len(row) != 3:
            named = {"\t": "tabs", ",": "commas"}[separator]
            raise UserError(
                f"{path}, line {number}: has {len(row)} column{'s' * (len(row) != 1)}, but a "
                f"triple has 3 (head, relation, tail) parted by {named}. Mend that line, or give "
                f"a file with the other separator its suffix: .tsv for tabs, .csv for commas."
            )
        if number == 1 and tuple(cell.strip().lower() for cell in row) in HEADERS:
            continue
        if not all(row):
            empty = ("head", "relation", "tail")[row.index("")]
            raise UserError(
                f"{path}, line {number}: the {empty} is empty. Fill it in or drop the line."
            )
        if not labels.take(*row):
            builder.add(*row)
    return builder.build(labels.chosen())


def _tab_rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    with open_bytes(path) as file:
        for first, lines in line_blocks(file, path):
            for number, raw in enumerate(lines, first):
                if line := decode(raw, path, number):
                    yield number, line.split("\t")


def _csv_rows(path: Path, separator: str) -> Iterator[tuple[int, list[str]]]:
    """Yield (number of the row's first line, cells)."""
    with open_bytes(path) as file:
        lines = (
            decode(raw, path, number) + "\n"
            for first, block in line_blocks(file, path)
            for number, raw in enumerate(block, first)
        )
        csv.field_size_limit(MAX_LINE)
        reader = csv.reader(lines, delimiter=separator, strict=True)
        start = 1
        while True:
            try:
                row = next(reader)
            except StopIteration:
                return
            except csv.Error as error:
                raise UserError(
                    f"{path}, line {start}: not well-formed CSV: {error}. "
                    f'Quote cells that hold commas or quotes, doubling each quote: "a ""b"" c".'
                ) from error
            if row:
                yield start, row
            start = reader.line_num + 1
