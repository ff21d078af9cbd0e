"""Graphs as lines: tables with columns of head, relation and tail; ConceptNet's assertions."""

import csv
import json
import re
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from itertools import chain, islice
from pathlib import Path
from typing import NamedTuple

from knowarm.errors import UserError, warn
from knowarm.knowledge.formats.columns import (
    CONFIDENCE,
    ROLES,
    Columns,
    Statements,
    cell_of_name,
    columns_of,
    confidence_key,
    confidence_of,
    listed,
    name_of_cell,
)
from knowarm.knowledge.formats.files import MAX_LINE, byte_lines, decode, text_lines
from knowarm.knowledge.formats.wide import is_wide, melt, names_columns
from knowarm.knowledge.graph.builder import GraphBuilder
from knowarm.knowledge.graph.graph import KnowledgeGraph, Triple
from knowarm.knowledge.graph.terms import LABEL_RELATIONS, RDF_TYPE, literal

Row = tuple[int, list[str]]
"""Number of a row's first line, and its cells."""

SEPARATORS = (",", "\t", ";", "|")
"""Separators of cells, tried in this order after that of the file's suffix."""
_SAMPLE = 50
"""Lines by which the separator is recognized."""
_QUOTED = re.compile('"((?:[^"]|"")*)"')
_NUMBER = re.compile(r"[-+]?\d+(?:[.,]\d+)?")
_BRACKETS = dict(zip("([{⟨（", ")]}⟩）", strict=True))
_BRACKET = re.compile(r"(?:^|\W)([(\[{⟨（])")
"""A bracket that opens before a word."""
_MARK = re.compile(r"(?!_:|<[^<>]*>$)(?:[^\w/:#\"'@.$?!&%~(\[{]|_(?=.*_$))")
"""Mark with which a head begins, and names do not."""
_SEPARATOR_LINE = re.compile(r'\s*"?sep=([^\w\s"]|\t)"?\s*', re.IGNORECASE)
"""The first line by which Excel knows the separator."""


class Dialect(NamedTuple):
    """How the cells of a table are separated."""

    separator: str
    skipped: int = 0  # Lines before the first row


def read_table(path: Path, separator: str) -> KnowledgeGraph:
    """Read a table of names, whose first row may name the columns (see `ROLES`).

    The separator is another one of `SEPARATORS` where the first rows have equally many cells by
    that one only, or what a first line "sep=;" of Excel says. Quoted cells may hold separators and,
    but for tabs, line ends (RFC 4180).
    """
    csv.field_size_limit(MAX_LINE)
    dialect = _dialect(path, separator)
    rows = _rows(path, dialect)
    return read_rows(path, rows, melt(path, *dialect))


def read_rows(path: Path, rows: Iterator[Row], if_wide: str) -> KnowledgeGraph:
    """Read rows of cells, of which the first may name the columns (see `ROLES`).

    Args:
        path: the file.
        rows: its rows.
        if_wide: what to do if a row holds a thing and its properties, a sentence without its end.
    """
    builder = GraphBuilder()
    first_row = next(rows, None)
    if first_row is None:
        return builder.build()
    names = first_row[1]
    if {"_start", "_end", "_type"}.issubset(names):
        return _read_apoc(path, names, rows)
    columns = columns_of(names, path)
    has_header = columns is not None
    if_empty = "Fill it in or delete the line."
    if columns is None:
        _refuse_header(path, first_row, if_wide)
        if names_columns(names):
            if_empty += f" {if_wide}."
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
    confidence_column = confidence_key(names)
    read = {*columns, *labels, confidence_column}
    others = [name for number, name in enumerate(names) if name and number not in read]
    if others:
        warn(f"{path}: these columns are not read: {listed(others)}.")
    words = set(map(name_of_cell, first_row[1]))
    occurs_again = has_header
    statements = Statements(path, builder)
    heads = set[str]()
    relations = Counter[str]()
    marks = _Marks()
    count = 0
    for number, row in rows:
        triple = _triple(path, number, row, names, columns, if_empty)
        confidence = None
        if confidence_column is not None:
            confidence = confidence_of(row[confidence_column], f"{path}, line {number}")
        statements.add(triple, confidence)
        for column, role in labels.items():
            if row[column]:
                builder.add_statement(
                    triple[role], LABEL_RELATIONS[0], literal(row[column])
                )
        if count > 0 and not words.isdisjoint(triple):
            occurs_again = True
        marks.add(triple)
        if not has_header:
            heads.add(triple[0])
            relations[triple[1]] += 1
        count += 1
    marks.refuse(path, count)
    if count > 1 and relations and all(map(_NUMBER.fullmatch, relations)):
        warn(
            f"{path}: the relations are numbers, such as {listed(islice(relations, 3))}. If the "
            "middle column is no relation, name the columns in a first line."
        )
    elif not has_header and is_wide(count, len(heads), relations):
        _doubt_relations(path, first_row, if_wide, relations, occurs_again)
    elif not occurs_again:
        _doubt_header(path, first_row, if_wide, count, len(heads), len(relations))
    return statements.build()


class _Marks:
    """Brackets and bullets around rows, which would become parts of names."""

    def __init__(self) -> None:
        self.marks = set[str]()
        self.in_brackets = 0

    def add(self, triple: Triple) -> None:
        """Count a row."""
        head, _, tail = triple
        if head.isidentifier() and head[0] != "_":  # most: fast
            self.marks.add("")
            return
        mark = _MARK.match(head)
        self.marks.add(mark[0] if mark else "")
        opening = _BRACKET.search(head)
        if opening is not None and _spans(opening[1], head, tail):
            self.in_brackets += 1

    def refuse(self, path: Path, rows: int) -> None:
        """Refuse a table if most of its rows have brackets, or all begin with one mark."""
        what = ""
        if 2 * self.in_brackets > rows:
            what = "most rows have brackets around them"
        mark = "".join(self.marks)
        if rows > 1 and mark and len(self.marks) == 1:
            what = f"all rows begin with {mark!r}"
        if what:
            raise UserError(
                f"{path}: {what}, which would become part of names. Write rows of three names, "
                "such as mug,usedFor,drinking."
            )


def _spans(opening: str, head: str, tail: str) -> bool:
    """Return whether a bracket opens in the head of a row and closes in its tail."""
    closing = _BRACKETS[opening]
    return (
        head.count(opening) > head.count(closing)
        and tail.count(closing) > tail.count(opening)
    )  # fmt: skip


def _refuse_header(path: Path, first_row: Row, if_wide: str) -> None:
    """Refuse a first row with no head, or that names columns of another number than three."""
    number, cells = first_row
    is_long = len(cells) > 2 * len(ROLES)
    is_other = len(cells) == 2 or any(cells[len(ROLES) :])
    if is_other and (is_long or names_columns(cells)):
        raise UserError(
            f"{path}, line {number}: {listed(cells)} name columns, but not which are head, "
            f"relation and tail; name them so. {if_wide}."
        )
    if not cells[0]:
        raise UserError(
            f"{path}, line {number}: the head is empty. Fill it in. {if_wide}."
        )


def _doubt_header(
    path: Path, first_row: Row, if_wide: str, rows: int, heads: int, relations: int
) -> None:
    """Warn of a first row that may name columns; refuse one that names those of a wide table."""
    number, cells = first_row
    where = f"{path}, line {number}: {listed(cells)}"
    if rows > 1 and heads == rows and names_columns(cells):
        raise _wide_header(where, if_wide)
    if max(3, relations) < rows:
        warn(
            f"{where} was read as a triple, but no word of it occurs again. If these are names of "
            "columns, write head,relation,tail."
        )


def _doubt_relations(
    path: Path,
    first_row: Row,
    if_wide: str,
    relations: Counter[str],
    occurs_again: bool,
) -> None:
    """Warn of a middle column that holds no relations; refuse a first row that says as much."""
    number, cells = first_row
    if not occurs_again and names_columns(cells):
        raise _wide_header(f"{path}, line {number}: {listed(cells)}", if_wide)
    if occurs_again:
        if_wide = (
            "If a line describes one thing and each column one of its properties, name the columns "
            "in a first line, such as object,use,material"
        )
    values = list(relations)[not occurs_again :]
    warn(
        f"{path}: {', '.join(values[:3])} were read as relations, but hardly one of them occurs "
        f"again. {if_wide}."
    )


def _wide_header(where: str, if_wide: str) -> UserError:
    """Return the error for a first row that names the columns of a wide table."""
    return UserError(
        f"{where} name columns, and none of them is the relation. If these are triples, write "
        f"head,relation,tail above them. {if_wide}."
    )


def _read_apoc(path: Path, names: list[str], rows: Iterator[Row]) -> KnowledgeGraph:
    """Read the nodes and relationships of `apoc.export.csv` of Neo4j, one of them per row.

    A node is named by its number and has the label "name"; its labels are its types.
    """
    builder = GraphBuilder()
    own = ("_id", "_labels", "_start", "_end", "_type", "name")
    others = [name for name in names if name and name not in own]
    if others:
        warn(f"{path}: these columns are not read: {listed(others)}.")
    for number, row in rows:
        if len(row) != len(names):
            raise _uneven(path, number, row, names, "Export it again.")
        cells = dict(zip(names, row, strict=True))
        if cells["_type"]:
            triple = (cells["_start"], cells["_type"], cells["_end"])
            if not all(triple):
                raise UserError(
                    f"{path}, line {number}: the relationship {cells['_type']} has no start or no "
                    "end. Export it again."
                )
            builder.add(*map(name_of_cell, triple))
            continue
        node = name_of_cell(cells.get("_id", ""))
        if not node:
            raise UserError(
                f"{path}, line {number}: is neither a node with an _id nor a relationship with a "
                "_type. Export it again."
            )
        builder.add_node(node)
        for kind in filter(None, cells.get("_labels", "").split(":")):
            builder.add(node, RDF_TYPE, name_of_cell(kind))
        if cells.get("name"):
            builder.add_statement(node, LABEL_RELATIONS[0], literal(cells["name"]))
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
    if_empty: str,
) -> Triple:
    """Return the names of head, relation and tail of a row."""
    if len(row) < len(names) or any(row[len(names) :]):
        remedy = (
            "Correct the line, delete it if it is no row, or name the columns in the first line, "
            "three of them head, relation and tail, such as head,relation,tail,weight."
        )
        raise _uneven(path, number, row, names, remedy)
    head, relation, tail = (name_of_cell(row[column]) for column in columns)
    for role, name in zip(ROLES, (head, relation, tail), strict=True):
        if not name:
            raise UserError(f"{path}, line {number}: the {role} is empty. {if_empty}")
    return head, relation, tail


def _uneven(
    path: Path, number: int, row: list[str], names: Sequence[str], remedy: str
) -> UserError:
    """Return the error for a row with another number of cells than there are columns."""
    plural = "" if len(row) == 1 else "s"
    return UserError(
        f"{path}, line {number}: has {len(row)} column{plural}, but a row has "
        f"{len(names)} ({listed(names)}). {remedy}"
    )


def _dialect(path: Path, expected: str) -> Dialect:
    """Return the separator that gives the first rows equally many cells, three or more."""
    lines = [line for _, line in islice(text_lines(path), _SAMPLE)]
    stated = _SEPARATOR_LINE.fullmatch(lines[0]) if lines else None
    if stated is not None:
        return Dialect(stated[1], skipped=1)
    for separator in dict.fromkeys((expected, *SEPARATORS)):
        with suppress(csv.Error):  # one that does not fit
            counts = {
                len(row) for row in csv.reader(lines, delimiter=separator) if any(row)
            }
            if len(counts) == 1 and max(counts) >= 3:
                return Dialect(separator)
    return Dialect(expected)


def _rows(path: Path, dialect: Dialect) -> Iterator[Row]:
    """Yield rows that are not blank, their cells without blanks around them."""
    separator = dialect.separator
    rows = _tab_rows(path) if separator == "\t" else _csv_rows(path, separator)
    for number, row in rows:
        cells = list(map(str.strip, row))
        if any(cells) and number > dialect.skipped:
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
