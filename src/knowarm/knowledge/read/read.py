"""A path goes in; the reader of its format is found, and a KnowledgeGraph comes out."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

from knowarm.errors import UserError, unknown_name
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.read.conceptnet import read_conceptnet
from knowarm.knowledge.read.ntriples import read_ntriples
from knowarm.knowledge.read.openke import read_openke
from knowarm.knowledge.read.rdf import read_rdf
from knowarm.knowledge.read.table import read_table

FORMATS: dict[str, Callable[[Path], KnowledgeGraph]] = {
    "turtle": partial(read_rdf, syntax="turtle"),
    "ntriples": read_ntriples,
    "rdfxml": partial(read_rdf, syntax="xml"),
    "jsonld": partial(read_rdf, syntax="json-ld"),
    "csv": partial(read_table, separator=","),
    "tsv": partial(read_table, separator="\t"),
    "openke": read_openke,
    "conceptnet": read_conceptnet,
}
"""The reader of each format, by the name that `--format` takes."""

SUFFIXES = {
    ".ttl": "turtle",
    ".turtle": "turtle",
    ".nt": "ntriples",
    ".owl": "rdfxml",
    ".rdf": "rdfxml",
    ".xml": "rdfxml",
    ".jsonld": "jsonld",
    ".json": "jsonld",
    ".csv": "csv",
    ".tsv": "tsv",
}
"""The format by the file's suffix; N-Triples and tables may also end in .gz, .bz2 or .xz."""

_PACKED = (".gz", ".bz2", ".xz")


def read_graph(path: str | Path, format: str | None = None) -> KnowledgeGraph:
    """Read a graph from a file, or from a folder of OpenKE files.

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
        format = _format_of(path)
    if format not in FORMATS:
        raise unknown_name("graph format", format, FORMATS)
    if path.is_dir() and format != "openke":
        raise UserError(f"{path} is a folder, but {format} is read from a file. Name the file.")
    return FORMATS[format](path)


def _format_of(path: Path) -> str:
    if path.is_dir():
        return "openke"
    if path.name.startswith("conceptnet-assertions"):
        return "conceptnet"
    packed = path.suffix.lower() in _PACKED
    suffix = Path(path.stem).suffix.lower() if packed else path.suffix.lower()
    format = SUFFIXES.get(suffix)
    if format is None:
        raise UserError(
            f"{path}: the suffix {suffix!r} tells no graph format. "
            f"Known: {', '.join(sorted(SUFFIXES))}; or name one of "
            f"{', '.join(FORMATS)} with --format."
        )
    if packed and format in ("turtle", "rdfxml", "jsonld"):
        raise UserError(f"{path}: {format} is not read packed. Unpack the file first.")
    return format
