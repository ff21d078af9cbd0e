"""Reading and writing of graphs by file format, and the shipped household graph."""

import re
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

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
from knowarm.reading import read_toml, replacing

SEPARATORS = {".csv": ",", ".tsv": "\t"}
"""What separates the cells of a table, by the first suffix of its format."""
READERS: dict[str, Callable[..., KnowledgeGraph]] = {
    "rdf": lambda path, suffix: read_rdf(path, _syntax(suffix)),
    "owl": lambda path, suffix: read_owl(path, suffix[1:]),
    "networkx": lambda path, suffix: read_with_networkx(path, suffix[1:]),
    "table": lambda path, suffix: read_table(path, SEPARATORS[suffix]),
    "json": lambda path, _: read_json_graph(path),
    "conceptnet": read_conceptnet,
    "written": lambda path, _: read_written(path),
    "folder": lambda path: read_parts(path)[0],
}
"""What reads files, given the first suffix of their format, if it has one."""


def _syntax(suffix: str) -> RdfFormat:
    syntax = RdfFormat.from_extension(suffix[1:])
    assert syntax is not None  # of a format that the file of formats lists
    return syntax


class Format(NamedTuple):
    """How files are read, and what they are recognized by."""

    reader: str
    suffixes: Sequence[str] = ()
    begins: str = "(?!)"

    def read(self, path: Path) -> KnowledgeGraph:
        """Read a file."""
        return READERS[self.reader](path, *self.suffixes[:1])

    def recognizes(self, content: str) -> bool:
        """Return whether content without comments before it is of this format."""
        if self.reader == "written":
            return looks_written(content)
        begins = self.begins.replace("PROLOG", _PROLOG).replace("JSON", _JSON)
        return re.match(begins, content, re.DOTALL) is not None


_PROLOG = r"(?>\s+|<\?.*?\?>|<!--.*?-->|<!DOCTYPE[^\[>]*(?:\[.*?\]\s*)?>)*+"
_JSON = r'(?:\{\s*["}]|\[\s*(?:[\[{"]|\]\s*\Z))'
_FILE = read_toml(Path(__file__).with_name("formats.toml"))
FORMATS = {name: Format(**fields) for name, fields in _FILE.items()}
"""The formats by name. Content is tried in this order."""

WRITTEN = (".rdf", ".jsonld", ".ttl", ".nt", *SEPARATORS)
"""Suffixes of the files that are written."""

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
    if path.suffix not in WRITTEN:
        raise UserError(
            f"{path}: graphs are written as {', '.join(WRITTEN)}, not {path.suffix!r}. "
            f"Give the file one of these suffixes."
        )
    with replacing(path, "Give another path.") as temporary:
        stated = _to_write(graph)
        if path.suffix in SEPARATORS:
            write_table(stated, temporary, SEPARATORS[path.suffix])
        else:
            write_rdf(stated, temporary, _syntax(path.suffix))


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
