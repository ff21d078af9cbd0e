"""A path goes in; the reader of its format is found, and a KnowledgeGraph comes out."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

from knowarm.errors import UserError, unknown_name
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.read.rdf import read_rdf

FORMATS: dict[str, Callable[[Path], KnowledgeGraph]] = {
    "turtle": partial(read_rdf, syntax="turtle"),
    "rdfxml": partial(read_rdf, syntax="xml"),
    "jsonld": partial(read_rdf, syntax="json-ld"),
}
"""The reader of each format, by the name that `--format` takes."""

SUFFIXES = {
    ".ttl": "turtle",
    ".turtle": "turtle",
    ".owl": "rdfxml",
    ".rdf": "rdfxml",
    ".xml": "rdfxml",
    ".jsonld": "jsonld",
    ".json": "jsonld",
}
"""The format by the file's suffix."""


def read_graph(path: str | Path, format: str | None = None) -> KnowledgeGraph:
    """Read a graph from a file or folder.

    Args:
        path: the file or folder.
        format: a key of FORMATS; None goes by the suffix.

    Raises:
        UserError: there is no such file, the format is unknown, or the file is malformed.
    """
    path = Path(path)
    if not path.exists():
        raise UserError(f"There is no graph file {path}. Give the path of a file, e.g. home.ttl.")
    if format is None:
        format = SUFFIXES.get(path.suffix.lower())
        if format is None:
            raise UserError(
                f"{path}: the suffix {path.suffix!r} tells no graph format. "
                f"Known: {', '.join(sorted(SUFFIXES))}; or name one of "
                f"{', '.join(FORMATS)} with --format."
            )
    if format not in FORMATS:
        raise unknown_name("graph format", format, FORMATS)
    return FORMATS[format](path)
