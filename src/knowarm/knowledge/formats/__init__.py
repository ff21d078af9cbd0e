"""Reading and writing of graphs by file format, and the shipped household graph."""

from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

from pyoxigraph import RdfFormat

from knowarm.errors import UserError, unknown_name
from knowarm.knowledge.formats.openke import read_openke_split
from knowarm.knowledge.formats.rdf import read_rdf, write_rdf
from knowarm.knowledge.formats.tables import read_conceptnet, read_table, write_table
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.reading import replacing

FORMATS: dict[str, Callable[[Path], KnowledgeGraph]] = {
    "turtle": partial(read_rdf, syntax=RdfFormat.TURTLE),
    "ntriples": partial(read_rdf, syntax=RdfFormat.N_TRIPLES),
    "rdfxml": partial(read_rdf, syntax=RdfFormat.RDF_XML),
    "jsonld": partial(read_rdf, syntax=RdfFormat.JSON_LD),
    "csv": partial(read_table, separator=","),
    "tsv": partial(read_table, separator="\t"),
    "openke": lambda folder: read_openke_split(folder).graph,
    "conceptnet": read_conceptnet,
}
"""Reader by name of the format."""

SUFFIXES = {f".{name}": name for name in ("turtle", "jsonld", "csv", "tsv")} | {
    ".ttl": "turtle",
    ".nt": "ntriples",
    ".json": "jsonld",
    **dict.fromkeys((".owl", ".rdf", ".xml"), "rdfxml"),
}
"""Format by suffix; each may be followed by one of `COMPRESSED`."""

COMPRESSED = (".gz", ".bz2", ".xz", ".zip")

WRITERS: dict[str, Callable[[KnowledgeGraph, Path], None]] = {
    ".ttl": partial(write_rdf, syntax=RdfFormat.TURTLE),
    ".nt": partial(write_rdf, syntax=RdfFormat.N_TRIPLES),
    ".rdf": partial(write_rdf, syntax=RdfFormat.RDF_XML),
    ".jsonld": partial(write_rdf, syntax=RdfFormat.JSON_LD),
    ".csv": partial(write_table, separator=","),
    ".tsv": partial(write_table, separator="\t"),
}
"""Writer by the file's suffix."""

_DATA = Path(__file__).parent.parent / "data"
HOUSEHOLD = _DATA / "household.ttl"
"""The default graph: 31 household objects and facts about them that matter to a robot arm."""
SHIPPED = {"household": HOUSEHOLD} | {
    name: _DATA / f"{name}.ttl" for name in ("objects", "purposes", "families")
}
"""Graphs that come with the package by name. "objects" holds the objects of the choose task, with
facts that can be asked; "purposes" what parts of objects are grasped for; "families" the instances
of families, written by ``scripts/draw_families.py``."""


def read_graph(path: str | Path | None = None, format: str | None = None) -> KnowledgeGraph:
    """Read a graph from a file, or from a folder of OpenKE files.

    Args:
        path: the file or folder, or the name of a shipped graph; None is "household".
        format: key of `FORMATS`; None takes the format of the suffix.

    Raises:
        UserError: there is no such file, the format is unknown, or the file is malformed.
    """
    if path is None or str(path) in SHIPPED:
        return shipped_graph(str(path or "household"))
    path = Path(path)
    if not path.exists():
        raise UserError(
            f"There is no graph file {path}. Give the path of a file, e.g. home.ttl, or the name "
            f"of a shipped graph: {', '.join(SHIPPED)}."
        )
    if format is None:
        format = _format_of(path)
    if format not in FORMATS:
        raise unknown_name("graph format", format, FORMATS)
    if path.is_dir() and format != "openke":
        raise UserError(f"{path} is a folder, but {format} is read from a file. Give the file.")
    return FORMATS[format](path)


def write_graph(graph: KnowledgeGraph, path: str | Path) -> None:
    """Write a graph to a file in the format of its suffix."""
    path = Path(path)
    if path.suffix not in WRITERS:
        raise UserError(
            f"{path}: graphs are written as {', '.join(WRITERS)}, not {path.suffix!r}. "
            f"Give the file one of these suffixes."
        )
    with replacing(path, "Give another path.") as temporary:
        WRITERS[path.suffix](graph, temporary)


@cache
def shipped_graph(name: str) -> KnowledgeGraph:
    """Read a graph of `SHIPPED`, once per process."""
    return read_graph(SHIPPED[name])


def household() -> KnowledgeGraph:
    """Return the shipped household graph."""
    return shipped_graph("household")


def _format_of(path: Path) -> str:
    if path.is_dir():
        return "openke"
    if path.name.startswith("conceptnet-assertions"):
        return "conceptnet"
    compressed = path.suffix.lower() in COMPRESSED
    suffix = (Path(path.stem) if compressed else path).suffix.lower()
    if suffix not in SUFFIXES:
        raise UserError(
            f"{path}: the suffix {suffix!r} belongs to no graph format. Known suffixes: "
            f"{', '.join(sorted(SUFFIXES))}. Or give the format: {', '.join(FORMATS)}."
        )
    return SUFFIXES[suffix]
