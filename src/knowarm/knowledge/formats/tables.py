"""Graphs as lines: tables with columns of head, relation and tail; ConceptNet's assertions."""

import csv
import json
import re
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from itertools import chain, islice
from pathlib import Path

from knowarm.errors import UserError, warn
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
from knowarm.knowledge.formats.files import MAX_LINE, byte_lines, decode, text_lines
from knowarm.knowledge.graph.builder import GraphBuilder
from knowarm.knowledge.graph.graph import KnowledgeGraph, Triple
from knowarm.knowledge.graph.terms import LABEL_RELATIONS, literal

Row = tuple[int, list[str]]
"""Number of a row's first line, and its cells."""

SEPARATORS = (",", "\t", ";", "|")
"""Separators of cells, tried in this order after that of the file's suffix."""
_SAMPLE = 50
"""Lines by which the separator is recognized."""
_QUOTED = re.compile('"((?:[^"]|"")*)"')


def read_table(path: Path, separator: str) -> KnowledgeGraph:
    """Read a table of names, whose first row may name the columns (see `ROLES`).

    The separator is another one of `SEPARATORS` where the first rows have equally many cells by
    that one only. Quoted cells may hold separators and, but for tabs, line ends (RFC 4180).
    """
    csv.field_size_limit(MAX_LINE)
    builder = GraphBuilder()
    rows = _rows(path, _separator(path, separator))
    first_row = next(rows, None)
    if first_row is None:
        return builder.build()
    names = first_row[1]
    columns = columns_of(names, path)
    has_header = columns is not None
    if columns is None:
        columns = Columns(0, 1, 2)
        names = list(ROLES)
        rows = chain([first_row], rows)
    numbers = {name: number for number, name in enumerate(names)}
    labels = dict[
        int, int
    ]()  # place in the triple by the column of its label, as KGTK has them
    for role, column in enumerate(columns):
        if f"{names[column]};label" in numbers:
            labels[numbers[f"{names[column]};label"]] = role
    confidence_column = numbers.get(CONFIDENCE)
    read = {*columns, *labels, confidence_column}
    others = [name for number, name in enumerate(names) if name and number not in read]
    if others:
        warn(f"{path}: these columns are not read: {listed(others)}.")
    words = set(map(name_of_cell, first_row[1]))
    occurs_again = has_header
    count = 0
    for number, row in rows:
        triple = _triple(path, number, row, names, columns)
        builder.add_statement(*triple)
        if confidence_column is not None:
            confidence = confidence_of(row[confidence_column], f"{path}, line {number}")
            # A triple of several rows is as certain as the surest of them.
            builder.confidence[triple] = max(
                confidence, builder.confidence.get(triple, 0.0)
            )
        for column, role in labels.items():
            if row[column]:
                builder.add_statement(
                    triple[role], LABEL_RELATIONS[0], literal(row[column])
                )
        if count > 0 and not words.isdisjoint(triple):
            occurs_again = True
        count += 1
    if not occurs_again and max(3, len(builder.relations)) < count:
        warn(
            f"{path}, line {first_row[0]}: {listed(first_row[1])} was read as a triple, but no "
            "word of it occurs again. If these are names of columns, write head,relation,tail."
        )
    return builder.build()


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


def _triple(
    path: Path,
    number: int,
    row: list[str],
    names: Sequence[str],
    columns: Columns,
) -> Triple:
    """Return the names of head, relation and tail of a row."""
    if len(row) < len(names) or any(row[len(names) :]):
        remedy = (
            "Correct the line, or name all columns in the first line, such as "
            "head,relation,tail,weight."
        )
        if number == 1 and len(row) > 2 * len(ROLES):
            remedy = (
                "If a line describes one thing and each column one of its properties, write a line "
                f"per property: pandas.read_csv({path.name!r}).melt({row[0]!r}).dropna()"
                ".to_csv('triples.csv', index=False, header=False)."
            )
        plural = "" if len(row) == 1 else "s"
        raise UserError(
            f"{path}, line {number}: has {len(row)} column{plural}, but a row has "
            f"{len(names)} ({listed(names)}). {remedy}"
        )
    head, relation, tail = (name_of_cell(row[column]) for column in columns)
    for role, name in zip(ROLES, (head, relation, tail), strict=True):
        if not name:
            raise UserError(
                f"{path}, line {number}: the {role} is empty. Fill it in or delete the line."
            )
    return head, relation, tail


def _separator(path: Path, expected: str) -> str:
    """Return the separator that gives the first rows equally many cells, three or more."""
    lines = [line for _, line in islice(text_lines(path), _SAMPLE)]
    for separator in dict.fromkeys((expected, *SEPARATORS)):
        with suppress(csv.Error):  # one that does not fit
            counts = {
                len(row) for row in csv.reader(lines, delimiter=separator) if any(row)
            }
            if len(counts) == 1 and max(counts) >= 3:
                return separator
    return expected


def _rows(path: Path, separator: str) -> Iterator[Row]:
    """Yield rows that are not blank, their cells without blanks around them."""
    rows = _tab_rows(path) if separator == "\t" else _csv_rows(path, separator)
    for number, row in rows:
        cells = list(map(str.strip, row))
        if any(cells):
            yield number, cells


def _tab_rows(path: Path) -> Iterator[Row]:
    """Split at tabs; a cell is quoted if it begins and ends with quotes."""
    for number, line in text_lines(path):
        cells = line.split("\t")
        if '"' in line:
            cells = list(map(_unquoted, cells))
        yield number, cells


def _unquoted(cell: str) -> str:
    """Return the content of a cell that may be quoted."""
    match = _QUOTED.fullmatch(cell)
    if match is None:
        return cell
    return match[1].replace('""', '"')


def _csv_rows(path: Path, separator: str) -> Iterator[Row]:
    """Split by the rules of CSV."""
    lines = (line + "\n" for _, line in text_lines(path))
    reader = csv.reader(lines, delimiter=separator, strict=True, skipinitialspace=True)
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
        yield start, row
        start = reader.line_num + 1


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
    wanted = None
    if relations is not None:
        wanted = {f"/r/{name}".encode() for name in relations}
    prefixes = tuple(f"/c/{language}/".encode() for language in sorted(languages))
    builder = GraphBuilder()
    for number, line in byte_lines(path):
        columns = line.split(b"\t")
        if not line.strip():
            continue
        if len(columns) != 5:
            raise UserError(
                f"{path}, line {number}: has {len(columns)} columns, but a ConceptNet assertion "
                f"has 5 (uri, relation, start, end, JSON). Give the file "
                f"conceptnet-assertions-5.*.csv as it was downloaded."
            )
        _, relation, start, end, properties = columns
        if not (start.startswith(prefixes) and end.startswith(prefixes)):
            continue
        if wanted is not None and relation not in wanted:
            continue
        if min_weight > 0 and _weight(properties, path, number) < min_weight:
            continue
        name = decode(relation, path, number).removeprefix("/r/")
        head = decode(start, path, number).split("/")[3]
        tail = decode(end, path, number).split("/")[3]
        builder.add(head, name, tail)
    return builder.build()


def _weight(properties: bytes, path: Path, number: int) -> float:
    try:
        return float(json.loads(properties)["weight"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise UserError(
            f"{path}, line {number}: the fifth column must be JSON with a number `weight`, "
            f"got {properties[:60].decode(errors='replace')!r}. Download the file again."
        ) from error
