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
from knowarm.knowledge.graph.graph import KnowledgeGraph
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
    first = next(rows, None)
    if first is None:
        return builder.build()
    names = first[1]
    columns = columns_of(names, path)
    named = columns is not None
    if columns is None:
        columns, names, rows = Columns(0, 1, 2), list(ROLES), chain([first], rows)
    by_name = {name: i for i, name in enumerate(names)}
    beside = {by_name.get(f"{names[i]};label"): place for place, i in enumerate(columns)}  # KGTK
    labels = [(place, number) for number, place in beside.items() if number is not None]
    sure = by_name.get(CONFIDENCE, -1)
    read = {*columns, *beside, sure}
    if others := [name for i, name in enumerate(names) if name and i not in read]:
        warn(f"{path}: these columns are not read: {listed(others)}.")
    count, again, words = 0, named, {name_of_cell(cell) for cell in first[1]}
    for number, row in rows:
        triple = _triple(path, number, row, names, columns)
        builder.add_statement(*triple)
        if sure >= 0:
            fact = triple[0], triple[1], triple[2]
            confidence = confidence_of(row[sure], f"{path}, line {number}")
            builder.confidence[fact] = max(confidence, builder.confidence.get(fact, 0.0))
        for name, label in labels:
            if row[label]:
                builder.add_statement(triple[name], LABEL_RELATIONS[0], literal(row[label]))
        again = again or (count > 0 and not words.isdisjoint(triple))
        count += 1
    if not again and max(3, len(builder.relations)) < count:
        warn(
            f"{path}, line {first[0]}: {listed(first[1])} was read as a triple, but no word of "
            "it occurs again. If these are names of columns, write head,relation,tail."
        )
    return builder.build()


def write_table(graph: KnowledgeGraph, path: Path, separator: str) -> None:
    """Write triples, with any confidence, then labels as rdfs:label; no entities without either."""
    labels = [
        (name, LABEL_RELATIONS[0], literal(text))
        for name, text in sorted(graph.own_labels().items())
    ]
    doubtful = graph.own_confidence()
    rows = (
        [*map(cell_of_name, triple), *([doubtful.get(triple, 1)] if doubtful else [])]
        for triple in (*graph, *labels)
    )
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, delimiter=separator, lineterminator="\n")
        writer.writerows(chain([[*ROLES, *([CONFIDENCE] if doubtful else [])]], rows))


def _triple(
    path: Path, number: int, row: list[str], names: Sequence[str], columns: Columns
) -> list[str]:
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
        raise UserError(
            f"{path}, line {number}: has {len(row)} column{'s' * (len(row) != 1)}, but a row has "
            f"{len(names)} ({listed(names)}). {remedy}"
        )
    triple = [name_of_cell(row[i]) for i in columns]
    if not all(triple):
        empty = [*ROLES][triple.index("")]
        raise UserError(
            f"{path}, line {number}: the {empty} is empty. Fill it in or delete the line."
        )
    return triple


def _separator(path: Path, expected: str) -> str:
    """Return the separator that gives the first rows equally many cells, three or more."""
    lines = [line for _, line in islice(text_lines(path), _SAMPLE)]
    for separator in dict.fromkeys((expected, *SEPARATORS)):
        with suppress(csv.Error):  # one that does not fit
            counts = {len(row) for row in csv.reader(lines, delimiter=separator) if any(row)}
            if len(counts) == 1 and max(counts) >= 3:
                return separator
    return expected


def _rows(path: Path, separator: str) -> Iterator[Row]:
    """Yield rows that are not blank, their cells without blanks around them."""
    raw = _tab_rows(path) if separator == "\t" else _csv_rows(path, separator)
    stripped = ((number, [cell.strip() for cell in row]) for number, row in raw)
    return ((number, row) for number, row in stripped if any(row))


def _tab_rows(path: Path) -> Iterator[Row]:
    """Split at tabs; a cell is quoted if it begins and ends with quotes."""
    for number, line in text_lines(path):
        cells = line.split("\t")
        if '"' in line:
            quoted = map(_QUOTED.fullmatch, cells)
            cells = [
                match[1].replace('""', '"') if match else cell
                for cell, match in zip(cells, quoted, strict=True)
            ]
        yield number, cells


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
    wanted = None if relations is None else {f"/r/{name}".encode() for name in relations}
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
        head, name, tail = (decode(column, path, number) for column in (start, relation, end))
        builder.add(head.split("/")[3], name.removeprefix("/r/"), tail.split("/")[3])
    return builder.build()


def _weight(properties: bytes, path: Path, number: int) -> float:
    try:
        return float(json.loads(properties)["weight"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise UserError(
            f"{path}, line {number}: the fifth column must be JSON with a number `weight`, "
            f"got {properties[:60].decode(errors='replace')!r}. Download the file again."
        ) from error
