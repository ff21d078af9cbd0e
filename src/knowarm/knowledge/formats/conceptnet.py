"""ConceptNet's assertion file, filtered while it is read."""

import json
from collections.abc import Collection
from pathlib import Path

from pyoxigraph import RdfFormat

from knowarm.errors import UserError
from knowarm.knowledge.builder import GraphBuilder
from knowarm.knowledge.formats.lines import byte_lines, decode
from knowarm.knowledge.formats.rdf import read_rdf, write_rdf
from knowarm.knowledge.graph import KnowledgeGraph


def read_conceptnet(
    path: Path,
    *,
    languages: Collection[str] = ("en",),
    relations: Collection[str] | None = None,
    min_weight: float = 1.0,
    cache: Path | None = None,
) -> KnowledgeGraph:
    """Read `conceptnet-assertions-5.*.csv` (also .gz): five tab-separated columns per line.

    `/c/en/teapot/n` becomes the entity "teapot", `/r/UsedFor` the relation "UsedFor".

    Args:
        path: the file.
        languages: keep edges between terms of these languages.
        relations: keep these relations ("UsedFor", ...); None keeps all.
        min_weight: keep edges of at least this weight.
        cache: N-Triples file that the kept edges are written to, or read from if it exists.

    Raises:
        UserError: a line does not have five columns, or its weight is not a number.
    """
    if cache is not None and cache.exists():
        return read_rdf(cache, RdfFormat.N_TRIPLES)
    wanted = None if relations is None else {f"/r/{name}".encode() for name in relations}
    prefixes = tuple(f"/c/{language}/".encode() for language in sorted(languages))
    builder = GraphBuilder()
    for number, line in byte_lines(path):
        columns = line.split(b"\t")
        if len(columns) != 5:
            if not line.strip():
                continue
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
        builder.add(_entity(head), name.removeprefix("/r/"), _entity(tail))
    graph = builder.build()
    if cache is not None:
        write_rdf(graph, cache, RdfFormat.N_TRIPLES)
    return graph


def _entity(uri: str) -> str:
    """Return the words of a term: "teapot" of `/c/en/teapot/n`."""
    return uri.split("/")[3]


def _weight(properties: bytes, path: Path, number: int) -> float:
    try:
        return float(json.loads(properties)["weight"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise UserError(
            f"{path}, line {number}: the fifth column must be JSON with a number `weight`, "
            f"got {properties[:60].decode(errors='replace')!r}. Download the file again."
        ) from error
