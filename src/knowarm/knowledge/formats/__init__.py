"""Reading and writing of graphs by file format, and the shipped household graph."""

import re
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

from pyoxigraph import RdfFormat

from knowarm.errors import UserError, unknown_name, warn
from knowarm.knowledge.formats.annotations import without_administration
from knowarm.knowledge.formats.documents import read_json_graph, read_with_networkx
from knowarm.knowledge.formats.files import beginning_of, suffix_of
from knowarm.knowledge.formats.imports import with_imports
from knowarm.knowledge.formats.others import refuse_others
from knowarm.knowledge.formats.rdf import read_owl, read_rdf, write_rdf
from knowarm.knowledge.formats.splits import read_parts
from knowarm.knowledge.formats.tables import read_conceptnet, read_table, write_table
from knowarm.knowledge.formats.written import looks_written, read_written
from knowarm.knowledge.graph.closure import closed
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.reading import replacing

Reader = Callable[[Path], KnowledgeGraph]
Writer = Callable[[KnowledgeGraph, Path], None]


class Format(NamedTuple):
    """How files are read, and what they are recognized by."""

    read: Reader
    suffixes: tuple[str, ...] = ()  # Each may be followed by one of `COMPRESSED`
    recognizes: Callable[[str], object] = lambda content: False
    """Whether content without comments before it is of this format."""


def _format(
    read: Callable[[Path, Any], KnowledgeGraph],
    kind: Any,
    *suffixes: str,
    begins: str = "(?!)",
) -> Format:
    """Return the format of files that a function reads as some kind, and how they begin."""
    recognizes = re.compile(begins, re.DOTALL).match
    return Format(lambda path: read(path, kind), suffixes, recognizes)


_PROLOG = r"(?>\s+|<\?.*?\?>|<!--.*?-->|<!DOCTYPE[^\[>]*(?:\[.*?\]\s*)?>)*+"
"""What may stand before the first element of XML."""
_JSON = r'(?:\{\s*["}]|\[\s*(?:[\[{"]|\]\s*\Z))'

_CONCEPTNET_API = r'"@id"\s*:\s*"/a/\[|"rel"\s*:\s*\{'
_JSON_LD = rf'(?={_JSON})(?!.*(?:{_CONCEPTNET_API})).*"@[a-z]+"'
"""A key of JSON-LD, and none of the edges of ConceptNet's API, which refer to a remote context."""

FORMATS: dict[str, Format] = {
    "rdfxml": _format(
        read_rdf,
        RdfFormat.RDF_XML,
        ".rdf",
        ".owl",
        ".xml",
        begins=_PROLOG + r"<(\w+:)?RDF\b",
    ),
    "graphml": _format(
        read_with_networkx, "graphml", ".graphml", begins=_PROLOG + r"<graphml\b"
    ),
    "gexf": _format(read_with_networkx, "gexf", ".gexf", begins=_PROLOG + r"<gexf\b"),
    "gml": _format(
        read_with_networkx,
        "gml",
        ".gml",
        begins=r"(?:(?:Creator|Version|comment|label)\s[^\n]*\n\s*)*graph\s*\[",
    ),
    "ofn": _format(read_owl, "ofn", ".ofn", begins=r"(Prefix|Ontology)\("),
    "omn": _format(read_owl, "omn", ".omn", begins="(Prefix|Ontology):"),
    "owx": _format(read_owl, "owx", ".owx", begins=_PROLOG + r"<(\w+:)?Ontology\b"),
    "obo": _format(read_owl, "obo", ".obo", begins="format-version:"),
    "jsonld": _format(read_rdf, RdfFormat.JSON_LD, ".jsonld", begins=_JSON_LD),
    "json": Format(
        read_json_graph,
        (".json", ".jsonl", ".ndjson", ".hext", ".srj", ".rj"),
        re.compile(_JSON).match,
    ),
    "turtle": _format(
        read_rdf,
        RdfFormat.TURTLE,
        ".ttl",
        ".turtle",
        begins=r"(?i:@?(prefix|base))\s[^<\s]*\s*<|\[\s*\]\s*<",
    ),
    "ntriples": _format(
        read_rdf,
        RdfFormat.N_TRIPLES,
        ".nt",
        begins=r"<[^<>\s]*:[^<>\s]*>\s+<[^<>\s]+>\s",
    ),
    "nquads": _format(read_rdf, RdfFormat.N_QUADS, ".nq"),
    "trig": _format(read_rdf, RdfFormat.TRIG, ".trig"),
    "n3": _format(read_rdf, RdfFormat.N3, ".n3"),
    "csv": _format(read_table, ",", ".csv"),
    "tsv": _format(read_table, "\t", ".tsv", ".txt"),
    "conceptnet": Format(
        read_conceptnet, recognizes=re.compile(r"/a/[^\t]*\t/r/").match
    ),
    "written": Format(read_written, (".md", ".markdown"), looks_written),
    "folder": Format(lambda folder: read_parts(folder)[0]),
}
"""The formats by name. Content is tried in this order."""

WRITERS: dict[str, Writer] = {
    ".rdf": partial(write_rdf, syntax=RdfFormat.RDF_XML),
    ".jsonld": partial(write_rdf, syntax=RdfFormat.JSON_LD),
    ".ttl": partial(write_rdf, syntax=RdfFormat.TURTLE),
    ".nt": partial(write_rdf, syntax=RdfFormat.N_TRIPLES),
    ".csv": partial(write_table, separator=","),
    ".tsv": partial(write_table, separator="\t"),
}
"""Writer by the file's suffix."""

_TEXT_RDF = ("turtle", "ntriples", "nquads", "trig", "n3")
"""Formats that the suffix tells apart, for their files may begin alike."""
_WEB_PAGE = re.compile("<!DOCTYPE html|<html", re.IGNORECASE)
"""How a page begins that was downloaded in place of a graph."""

_DATA = Path(__file__).parent.parent / "data"
HOUSEHOLD = _DATA / "household.ttl"
"""The default graph: 31 household objects and facts about them that matter to a robot arm."""
SHIPPED = {
    "household": HOUSEHOLD,
    "objects": _DATA / "objects.ttl",
    "purposes": _DATA / "purposes.ttl",
    "families": _DATA / "families.ttl",
}
"""Graphs that come with the package by name. "objects" holds the objects of the choose task, with
facts that can be asked; "purposes" what parts of objects are grasped for; "families" the instances
of families, written by ``scripts/draw_families.py``."""


def read_graph(
    path: str | Path | None = None, format: str | None = None
) -> KnowledgeGraph:
    """Read a graph from a file, or from a folder of triples split into train, valid and test.

    Args:
        path: the file or folder, or the name of a shipped graph; None is "household".
        format: key of `FORMATS`; None recognizes it by content and suffix.

    Raises:
        UserError: there is no such file, the format is unknown, or the file is malformed or holds
            no triples.

    Warns:
        DataWarning: something in the file is left out, its first line may be a header, an ontology
            that it imports is not at hand, or what follows from its axioms was added.
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
    if path.is_dir() and format != "folder":
        raise UserError(
            f"{path} is a folder, but {format} is read from a file. Give the file."
        )
    graph = FORMATS[format].read(path)
    if not len(graph):
        raise UserError(
            f"{path} holds no triples (read as {format}). Check that it is complete, and that it "
            "is a graph."
        )
    if format != "folder":
        graph = with_imports(graph, path, _read_file)
    graph = without_administration(graph, path)
    graph, message = closed(graph)
    if message:
        warn(f"{path}: {message}.")
    return graph


def _read_file(path: Path) -> KnowledgeGraph:
    return FORMATS[_format_of(path)].read(path)


def write_graph(graph: KnowledgeGraph, path: str | Path) -> None:
    """Write what a graph states to a file in the format of its suffix.

    What follows from axioms is derived again when the file is read.
    """
    path = Path(path)
    if path.suffix not in WRITERS:
        raise UserError(
            f"{path}: graphs are written as {', '.join(WRITERS)}, not {path.suffix!r}. "
            f"Give the file one of these suffixes."
        )
    with replacing(path, "Give another path.") as temporary:
        WRITERS[path.suffix](_to_write(graph), temporary)


def _to_write(graph: KnowledgeGraph) -> KnowledgeGraph:
    """Return what a graph states if the rest follows from it, else the whole graph."""
    stated = graph.stated()
    if stated is not graph and closed(stated).graph == graph:
        return stated
    return graph


@cache
def shipped_graph(name: str) -> KnowledgeGraph:
    """Read a graph of `SHIPPED`, once per process."""
    return read_graph(SHIPPED[name])


def household() -> KnowledgeGraph:
    """Return the shipped household graph."""
    return shipped_graph("household")


def _format_of(path: Path) -> str:
    """Return the format of a file by its content, and where that is open by its suffix."""
    if path.is_dir():
        return "folder"
    suffix = suffix_of(path)
    content = re.sub(r"\A(\s|#.*\n)*", "", beginning_of(path))
    refuse_others(path, suffix, content)
    suffixes = {}
    for name, known in FORMATS.items():
        suffixes.update(dict.fromkeys(known.suffixes, name))
    by_suffix = suffixes.get(suffix)
    tried = list(FORMATS)
    if suffix in (".csv", ".tsv"):
        # The first cell may look like any other format.
        tried = ["conceptnet", "json", "written"]
    elif by_suffix in _TEXT_RDF or content.startswith("<?xml"):
        tried.remove("written")
    alike = (name for name in tried if FORMATS[name].recognizes(content))
    by_content = next(alike, None)
    if by_suffix in _TEXT_RDF and by_content in _TEXT_RDF:
        return by_suffix
    if by_content is None and _WEB_PAGE.match(content):
        raise UserError(f"{path}: this is an HTML page. Download the file itself.")
    recognized = by_content or by_suffix
    if recognized is None:
        raise UserError(
            f"{path}: the suffix {suffix!r} and the content belong to no graph format. Known "
            f"suffixes: {', '.join(sorted(suffixes))}. Or give the format: "
            f"{', '.join(FORMATS)}."
        )
    return recognized
