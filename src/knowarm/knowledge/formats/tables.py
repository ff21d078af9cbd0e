"""CSV and TSV tables with the columns head, relation and tail."""

import csv
from collections.abc import Iterator
from pathlib import Path

from knowarm.errors import UserError
from knowarm.knowledge.builder import GraphBuilder
from knowarm.knowledge.formats.lines import MAX_LINE, text_lines
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.terms import LABEL_RELATIONS, literal

HEADERS = (("head", "relation", "tail"), ("h", "r", "t"), ("subject", "predicate", "object"))
"""First rows that name the columns and are no triple."""


def read_table(path: Path, separator: str) -> KnowledgeGraph:
    """Read a table of names; a first row such as `head,relation,tail` is skipped.

    CSV follows RFC 4180: quoted cells may hold commas and line ends. TSV has no quoting.

    Raises:
        UserError: a row does not have three columns, or one is empty; the line is named.
    """
    builder = GraphBuilder()
    for number, row in _tab_rows(path) if separator == "\t" else _csv_rows(path, separator):
        if len(row) != 3:
            named = {"\t": "tabs", ",": "commas"}[separator]
            raise UserError(
                f"{path}, line {number}: has {len(row)} column{'s' * (len(row) != 1)}, but a "
                f"triple has 3 (head, relation, tail) separated by {named}. Correct the line, or "
                f"give the file the suffix of its separator: .tsv for tabs, .csv for commas."
            )
        if number == 1 and tuple(cell.strip().lower() for cell in row) in HEADERS:
            continue
        if not all(row):
            empty = HEADERS[0][row.index("")]
            raise UserError(
                f"{path}, line {number}: the {empty} is empty. Fill it in or delete the line."
            )
        builder.add_statement(*row)
    return builder.build()


def write_table(graph: KnowledgeGraph, path: Path, separator: str) -> None:
    """Write triples, then labels as rdfs:label triples. Entities without either are left out.

    Raises:
        UserError: a name contains a tab or line end, which TSV cannot hold.
    """
    labels = [
        (name, LABEL_RELATIONS[0], literal(text))
        for name, text in sorted(graph.own_labels().items())
    ]
    with path.open("w", encoding="utf-8", newline="") as file:
        if separator == ",":
            csv.writer(file, lineterminator="\n").writerows([HEADERS[0], *graph, *labels])
            return
        file.write("\t".join(HEADERS[0]) + "\n")
        for triple in (*graph, *labels):
            if any(bad in name for name in triple for bad in "\t\n\r"):
                raise UserError(
                    f"The triple {triple!r} contains a tab or line end, which TSV cannot hold. "
                    f"Write CSV or Turtle."
                )
            file.write("\t".join(triple) + "\n")


def _tab_rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    return ((number, line.split("\t")) for number, line in text_lines(path) if line)


def _csv_rows(path: Path, separator: str) -> Iterator[tuple[int, list[str]]]:
    """Yield (number of the row's first line, cells)."""
    csv.field_size_limit(MAX_LINE)
    lines = (line + "\n" for _, line in text_lines(path))
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
                f'Quote cells that contain commas or quotes, doubling each quote: "a ""b"" c".'
            ) from error
        if row:
            yield start, row
        start = reader.line_num + 1
