"""Graphs as lines: CSV and TSV tables of head, relation, tail; ConceptNet's assertions."""

import bz2
import csv
import gzip
import json
import lzma
import zipfile
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import IO, Any

from knowarm.errors import UserError
from knowarm.knowledge.graph.builder import GraphBuilder
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.terms import LABEL_RELATIONS, literal
from knowarm.reading import reading

OPENERS: dict[str, Callable[[Path], Any]] = {".gz": gzip.open, ".bz2": bz2.open, ".xz": lzma.open}
"""Function that opens a compressed file, by suffix."""
MAX_LINE = 1 << 20
"""Longest line in bytes; a file with a longer one is not line-based."""


def open_bytes(path: Path) -> IO[bytes]:
    """Open a file for reading bytes, decompressing .gz, .bz2, .xz and .zip (with one member)."""
    suffix = path.suffix.lower()
    if suffix == ".zip":
        archive = zipfile.ZipFile(path)
        if len(names := archive.namelist()) != 1:
            raise UserError(
                f"{path} must contain one file, but contains {', '.join(names[:6]) or 'none'}. "
                f"Unpack it and give the path of the file."
            )
        return archive.open(names[0])
    return OPENERS[suffix](path) if suffix in OPENERS else path.open("rb")


def byte_lines(path: Path) -> Iterator[tuple[int, bytes]]:
    """Yield (line number, line without its end) of a file."""
    number = 0
    with reading(path, "Copy or compress it again."), open_bytes(path) as file:
        while line := file.readline(MAX_LINE + 1):
            number += 1
            if len(line) > MAX_LINE:
                raise UserError(
                    f"{path}, line {number}: the line is longer than {MAX_LINE:,} bytes, so "
                    f"the file does not hold one record per line. Check the format."
                )
            yield number, line.rstrip(b"\r\n")


def text_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield (line number, text without its end) of a UTF-8 file."""
    return ((number, decode(line, path, number)) for number, line in byte_lines(path))


def decode(line: bytes, path: Path, number: int) -> str:
    """Decode one line."""
    try:
        text = line.decode()
    except UnicodeDecodeError as error:
        raise UserError(
            f"{path}, line {number}: not UTF-8 ({error.reason} at byte {error.start}). "
            f"Convert the file, e.g. `iconv -f latin1 -t utf-8`."
        ) from error
    if "\0" in text:
        raise UserError(
            f"{path}, line {number}: contains a zero byte, so this is not a text file. "
            f"Check the path and the format."
        )
    return text.removeprefix("\ufeff") if number == 1 else text


HEADERS = (("head", "relation", "tail"), ("h", "r", "t"), ("subject", "predicate", "object"))
"""First rows that name the columns and are no triple."""


def read_table(path: Path, separator: str) -> KnowledgeGraph:
    """Read a table of names; a first row such as `head,relation,tail` is skipped.

    CSV follows RFC 4180: quoted cells may hold commas and line ends. TSV has no quoting.
    """
    builder = GraphBuilder()
    tabs = ((number, line.split("\t")) for number, line in text_lines(path) if line)
    rows = tabs if separator == "\t" else _csv_rows(path, separator)
    for index, (number, row) in enumerate(rows):
        if len(row) != 3:
            named = {"\t": "tabs", ",": "commas"}[separator]
            raise UserError(
                f"{path}, line {number}: has {len(row)} column{'s' * (len(row) != 1)}, but a "
                f"triple has 3 (head, relation, tail) separated by {named}. Correct the line, or "
                f"give the file the suffix of its separator: .tsv for tabs, .csv for commas."
            )
        if not index and tuple(cell.strip().lower() for cell in row) in HEADERS:
            continue
        if not all(row):
            empty = HEADERS[0][row.index("")]
            raise UserError(
                f"{path}, line {number}: the {empty} is empty. Fill it in or delete the line."
            )
        builder.add_statement(*row)
    return builder.build()


def write_table(graph: KnowledgeGraph, path: Path, separator: str) -> None:
    """Write triples, then labels as rdfs:label triples. Entities without either are left out."""
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


def _csv_rows(path: Path, separator: str) -> Iterator[tuple[int, list[str]]]:
    """Yield (number of the row's first line, cells)."""
    csv.field_size_limit(MAX_LINE)
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
        if row:
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
