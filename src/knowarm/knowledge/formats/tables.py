"""Graphs as lines: tables with columns of head, relation and tail; ConceptNet's assertions."""

import csv
import json
import re
from collections.abc import Collection, Iterator
from contextlib import suppress
from itertools import chain, islice
from operator import itemgetter
from pathlib import Path
from typing import Any

from knowarm.errors import UserError
from knowarm.knowledge.formats.columns import (
    CONFIDENCE,
    ROLES,
    Columns,
    cell_of_name,
    columns_of,
    confidence_of,
    listed,
    name_of_cell,
)
from knowarm.knowledge.formats.doubts import doubt, melt, refuse_marks
from knowarm.knowledge.formats.files import MAX_LINE, text_lines
from knowarm.knowledge.formats.records import Statements
from knowarm.knowledge.graph.builder import GraphBuilder
from knowarm.knowledge.graph.graph import KnowledgeGraph, Triple
from knowarm.knowledge.graph.terms import RDF_TYPE

Row = tuple[str, list[str]]
"""Where a row begins, "a.csv, line 3", and its cells."""

SEPARATORS = (",", "\t", ";", "|")
"""Separators of cells, tried in this order after that of the file's suffix."""
_SAMPLE = 50
"""Lines by which the separator is recognized."""
_JUDGED = 10_000
"""Rows by which it is known whether they are triples."""
_QUOTED = re.compile('"((?:[^"]|"")*)"')
_SEPARATOR_LINE = re.compile(r'\s*"?sep=([^\w\s"]|\t)"?\s*', re.IGNORECASE)
"""The first line by which Excel knows the separator."""


def read_table(path: Path, separator: str) -> KnowledgeGraph:
    """Read a table of names, whose first row may name the columns (see `ROLES`).

    The separator is another one of `SEPARATORS` where the first rows have equally many cells by
    that one only, or what a first line "sep=;" of Excel says. Quoted cells may hold separators and,
    but for tabs, line ends (RFC 4180).
    """
    csv.field_size_limit(MAX_LINE)
    dialect = _dialect(path, separator)
    return read_rows(path, _rows(path, *dialect), melt(path, *dialect))


def read_rows(path: Path, rows: Iterator[Row], if_wide: str) -> KnowledgeGraph:
    """Read rows of cells, of which the first may name the columns (see `ROLES`).

    Args:
        path: the file.
        rows: its rows.
        if_wide: what to do if a row holds a thing and its properties, a sentence without its end.
    """
    statements = Statements(path)
    first_row = next(rows, None)
    if first_row is None:
        return statements.build()
    first_where, names = first_row
    if {"_start", "_end", "_type"}.issubset(names):
        return _read_apoc(names, rows, statements)
    columns = columns_of(tuple(names), str(path))
    has_header = columns is not None
    if_empty = "Fill it in or delete the line."
    if columns is None:
        if len(names) > 1:
            _refuse_uneven(first_where, names, ROLES, f" {if_wide}.")
        if_empty += f" {if_wide}."
        names = list(ROLES)
        columns = Columns((0, 1, 2))
        rows = chain([first_row], rows)
    labels = {}
    """Place in the triple by the column of its label, as KGTK has them."""
    for role, column in enumerate(columns.triple):
        label = f"{names[column]};label"
        if label in names:
            labels[names.index(label)] = role
    statements.unread.update({*columns.others} - set(map(names.__getitem__, labels)))
    cells_of = itemgetter(*columns.triple)
    judged: list[Triple] = []
    for where, row in rows:
        _refuse_uneven(where, row, names)
        head, relation, tail = map(name_of_cell, cells_of(row))
        triple = (head, relation, tail)
        if not all(triple):
            empty = list(ROLES)[triple.index("")]
            raise UserError(f"{where}: the {empty} is empty. {if_empty}")
        confidence = confidence_of(columns, row, where)
        statements.add(triple, confidence)
        for column, role in labels.items():
            if row[column]:
                statements.add_label(triple[role], row[column])
        if len(judged) < _JUDGED:
            judged.append(triple)
    refuse_marks(path, judged)
    if not has_header:
        doubt(first_where, judged, if_wide)
    return statements.build()


def _read_apoc(
    names: list[str], rows: Iterator[Row], statements: Statements
) -> KnowledgeGraph:
    """Read the nodes and relationships of `apoc.export.csv` of Neo4j, one of them per row.

    A node is named by its number and has the label "name"; its labels are its types.
    """
    own = {"_id", "_labels", "_start", "_end", "_type", "name"}
    statements.unread.update(filter(None, {*names} - own))
    for where, row in rows:
        _refuse_uneven(where, row, names)
        cells = dict(zip(names, row, strict=False))
        triple = [cells["_start"], cells["_type"], cells["_end"]]
        node = name_of_cell(cells.get("_id", ""))
        if all(triple):
            head, relation, tail = map(name_of_cell, triple)
            statements.add((head, relation, tail))
        elif cells["_type"] or not node:
            raise UserError(
                f"{where}: is neither a node with an _id nor a relationship with _start, _type and "
                f"_end ({listed(filter(None, row))}). Export it again."
            )
        else:
            statements.builder.add_node(node)
            for kind in filter(None, cells.get("_labels", "").split(":")):
                statements.add((node, RDF_TYPE, name_of_cell(kind)))
            if cells.get("name"):
                statements.add_label(node, cells["name"])
    return statements.build()


def write_table(graph: KnowledgeGraph, path: Path, separator: str) -> None:
    """Write triples, with any confidence, then labels as rdfs:label; no entities without either."""
    doubtful = graph.own_confidence()
    header = list(ROLES)
    if doubtful:
        header.append(CONFIDENCE)
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, delimiter=separator, lineterminator="\n")
        writer.writerow(header)
        for triple in chain(graph, graph.label_statements()):
            row: list[object] = list(map(cell_of_name, triple))
            if doubtful:
                row.append(doubtful.get(triple, 1))
            writer.writerow(row)


def _refuse_uneven(
    where: str, row: list[str], names: Collection[str], if_wide: str = ""
) -> None:
    """Refuse a row with another number of cells than there are columns, but for blank ones."""
    if len(row) < len(names) or any(row[len(names) :]):
        plural = "" if len(row) == 1 else "s"
        raise UserError(
            f"{where}: has {len(row)} column{plural}, but a row has {len(names)} "
            f"({listed(names)}). Correct the line, delete it if it is no row, or name the columns "
            "in the first line, three of them head, relation and tail, such as "
            f"head,relation,tail,weight.{if_wide}"
        )


def _dialect(path: Path, expected: str) -> tuple[str, int]:
    """Return the separator, and how many lines stand before the first row.

    The separator gives the first rows equally many cells, three or more.
    """
    lines = [line for _, line in islice(text_lines(path), _SAMPLE)]
    stated = _SEPARATOR_LINE.fullmatch(lines[0]) if lines else None
    if stated is not None:
        return stated[1], 1
    for separator in dict.fromkeys((expected, *SEPARATORS)):
        with suppress(csv.Error):  # one that does not fit
            counts = {
                len(row) for row in csv.reader(lines, delimiter=separator) if any(row)
            }
            if len(counts) == 1 and max(counts) >= 3:
                return separator, 0
    return expected, 0


def _rows(path: Path, separator: str, skipped: int) -> Iterator[Row]:
    """Yield rows that are not blank, their cells without blanks around them.

    Between tabs, a cell is quoted if it begins and ends with quotes; else by the rules of CSV.
    """
    is_tab = separator == "\t"
    options: Any = {"strict": True, "skipinitialspace": True}
    if is_tab:
        options = {"quoting": csv.QUOTE_NONE}
    lines = (line + "\n" for _, line in text_lines(path))
    reader = csv.reader(lines, delimiter=separator, **options)
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
        if is_tab:
            row = list(map(_unquoted, row))
        cells = list(map(str.strip, row))
        if any(cells) and start > skipped:
            yield f"{path}, line {start}", cells
        start = reader.line_num + 1


def _unquoted(cell: str) -> str:
    """Return the content of a cell that may be quoted."""
    match = _QUOTED.fullmatch(cell)
    if match is None:
        return cell
    return match[1].replace('""', '"')


def read_conceptnet(
    path: Path,
    *,
    languages: Collection[str] = ("en",),
    relations: Collection[str] | None = None,
    min_weight: float = 1.0,
) -> KnowledgeGraph:
    """Read `conceptnet-assertions-5.*.csv` (also .gz): five tab-separated columns per line.

    `/c/en/teapot/n` becomes the entity "teapot", `/r/UsedFor` the relation "UsedFor". Kept are
    edges of at least a weight between terms of these languages, of these or all relations.
    """
    prefixes = tuple(f"/c/{language}/" for language in languages)
    builder = GraphBuilder()
    for number, line in text_lines(path):
        where = f"{path}, line {number}"
        cells = line.split("\t")
        if not line.strip():
            continue
        if len(cells) != 5:
            raise UserError(
                f"{where}: has {len(cells)} columns, but a ConceptNet assertion has 5 (uri, "
                "relation, start, end, JSON). Give the file conceptnet-assertions-5.*.csv as it "
                "was downloaded."
            )
        _, relation, start, end, properties = cells
        name = relation.removeprefix("/r/")
        if not (start.startswith(prefixes) and end.startswith(prefixes)):
            continue
        if relations is not None and name not in relations:
            continue
        if min_weight <= 0 or _weight(properties, where) >= min_weight:
            builder.add(start.split("/")[3], name, end.split("/")[3])
    return builder.build()


def _weight(properties: str, where: str) -> float:
    try:
        return float(json.loads(properties)["weight"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise UserError(
            f"{where}: the fifth column must be JSON with a number `weight`, got "
            f"{properties[:60]!r}. Download the file again."
        ) from error
