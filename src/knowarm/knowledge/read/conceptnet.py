"""ConceptNet's assertions go in, filtered while they are read; a KnowledgeGraph comes out."""

import json
from collections.abc import Collection
from pathlib import Path

from knowarm.errors import UserError
from knowarm.knowledge.builder import GraphBuilder
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.read.lines import decode, line_blocks, open_bytes
from knowarm.knowledge.write.ntriples import write_ntriples


def read_conceptnet(
    path: Path,
    *,
    languages: Collection[str] = ("en",),
    relations: Collection[str] | None = None,
    min_weight: float = 1.0,
    cache: Path | None = None,
) -> KnowledgeGraph:
    """Read `conceptnet-assertions-5.*.csv` (also .gz): five tab-separated columns a line.

    `/c/en/cereal_box/n` becomes the entity "cereal_box", `/r/UsedFor` the relation "UsedFor".

    Args:
        path: the file.
        languages: keep edges between terms of these languages.
        relations: keep these ("UsedFor", ...); None keeps all.
        min_weight: keep edges of at least this weight.
        cache: write what was kept to this N-Triples file; if it exists already, read it instead.

    Raises:
        UserError: a line has not five columns, or holds a weight that is no number.
    """
    if cache is not None and cache.exists():
        from knowarm.knowledge.read.ntriples import read_ntriples

        return read_ntriples(cache)
    wanted = None if relations is None else {f"/r/{name}".encode() for name in relations}
    prefixes = tuple(f"/c/{language}/".encode() for language in sorted(languages))
    builder = GraphBuilder()
    with open_bytes(path) as file:
        for first, lines in line_blocks(file, path):
            for number, line in enumerate(lines, first):
                columns = line.rstrip(b"\r").split(b"\t")
                if len(columns) != 5:
                    if not line.strip():
                        continue
                    raise UserError(
                        f"{path}, line {number}: has {len(columns)} columns, but a ConceptNet "
                        f"assertion has 5 (uri, relation, start, end, JSON). Give the file "
                        f"conceptnet-assertions-5.*.csv as it was downloaded."
                    )
                _, relation, start, end, facts = columns
                if not (start.startswith(prefixes) and end.startswith(prefixes)):
                    continue
                if wanted is not None and relation not in wanted:
                    continue
                if min_weight > 0 and _weight(facts, path, number) < min_weight:
                    continue
                builder.add(
                    _term(decode(start, path, number)),
                    decode(relation, path, number).removeprefix("/r/"),
                    _term(decode(end, path, number)),
                )
    graph = builder.build({})
    if cache is not None:
        write_ntriples(graph, cache)
    return graph


def _term(uri: str) -> str:
    """Return the words of `/c/en/cereal_box/n`: "cereal_box"."""
    return uri.split("/")[3]


def _weight(facts: bytes, path: Path, number: int) -> float:
    try:
        return float(json.loads(facts)["weight"])
    except (ValueError, KeyError, TypeError) as error:
        raise UserError(
            f"{path}, line {number}: the fifth column must be JSON with a number `weight`, "
            f"got {facts[:60].decode(errors='replace')!r}. Fetch the file again."
        ) from error
