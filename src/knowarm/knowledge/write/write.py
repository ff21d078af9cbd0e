"""A graph and a path go in; the file, in the format of its suffix, comes out."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

from knowarm.errors import UserError
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.write.ntriples import write_ntriples
from knowarm.knowledge.write.table import write_table
from knowarm.knowledge.write.turtle import write_turtle

WRITERS: dict[str, Callable[[KnowledgeGraph, Path], None]] = {
    ".ttl": write_turtle,
    ".nt": write_ntriples,
    ".csv": partial(write_table, separator=","),
    ".tsv": partial(write_table, separator="\t"),
}
"""The writer by the file's suffix."""


def write_graph(graph: KnowledgeGraph, path: str | Path) -> None:
    """Write a graph to a file.

    Raises:
        UserError: the suffix tells no format, or the file cannot be written.
    """
    path = Path(path)
    if path.suffix not in WRITERS:
        raise UserError(
            f"{path}: graphs are written as {', '.join(WRITERS)}, not {path.suffix!r}. "
            f"Give the file one of these suffixes."
        )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        WRITERS[path.suffix](graph, path)
    except OSError as error:
        raise UserError(f"Cannot write {path}: {error.strerror}. Give another place.") from error
