"""RDF files: Turtle, N-Triples, RDF/XML and JSON-LD, parsed and serialized by pyoxigraph.

Nothing is fetched: a JSON-LD context must lie in the file itself.
"""

import heapq
import re
from codecs import BOM_UTF8
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from xml.parsers import expat

from pyoxigraph import NamedNode, RdfFormat, Triple, parse, serialize

from knowarm.errors import UserError
from knowarm.knowledge.formats.tables import open_bytes
from knowarm.knowledge.graph.builder import GraphBuilder
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.terms import (
    LABEL_RELATIONS,
    NAMESPACE,
    Term,
    blank_names,
    iri_of_name,
    literal,
    name_of_iri,
    name_of_term,
    triple_of_names,
)
from knowarm.reading import reading

PREFIXES = {
    "": NAMESPACE,
    "rdf": "http://www.w3.org/1999/02/22-rdf-syntax-ns#",
    "rdfs": "http://www.w3.org/2000/01/rdf-schema#",
    "owl": "http://www.w3.org/2002/07/owl#",
    "skos": "http://www.w3.org/2004/02/skos/core#",
    "xsd": "http://www.w3.org/2001/XMLSchema#",
}
"""Prefixes of written Turtle and of SPARQL queries."""

_GENERATED = re.compile(r"_:[a-f][0-9a-f]{25,31}")
"""Random names that pyoxigraph gives to blank nodes without a name."""
_XML_NAME = re.compile(r"[^\W\d][\w.-]*$")
"""End of an IRI that RDF/XML can write as an element."""


def read_rdf(path: Path, syntax: RdfFormat) -> KnowledgeGraph:
    """Read an RDF file, plain or compressed (.gz, .bz2, .xz).

    rdfs:label and skos:prefLabel become labels. Unnamed blank nodes are numbered in the order of
    the file, and named graphs are merged.
    """
    builder = GraphBuilder()
    base = None if syntax == RdfFormat.N_TRIPLES else path.absolute().as_uri()

    def name(term: Term | Triple) -> str:
        return term.value if isinstance(term, NamedNode) else name_of_term(term)

    with reading(path, "Correct, copy or compress it again."):
        mark = _refuse_binary(path)
        try:
            with open_bytes(path) as file:
                file.read(mark)
                for quad in parse(file, format=syntax, base_iri=base):
                    head, tail, relation = quad.subject, quad.object, quad.predicate.value
                    if type(head) is NamedNode and type(tail) is NamedNode:  # most triples: fast
                        builder.add(head.value, relation, tail.value)
                    else:
                        builder.add_statement(name(head), relation, name(tail))
        except SyntaxError as error:
            raise _malformed(path, syntax, error) from error
        unnamed: dict[str, str] = defaultdict(blank_names({*builder.entities}).__next__)
        builder.rename(lambda n: unnamed[n] if _GENERATED.fullmatch(n) else name_of_iri(n))
        return builder.build()


def write_rdf(graph: KnowledgeGraph, path: Path, syntax: RdfFormat) -> None:
    """Write triples and labels, sorted by head. Entities without either are not in RDF."""
    bad = next((n for n in graph.relations_used if not _XML_NAME.search(iri_of_name(n))), None)
    if syntax == RdfFormat.RDF_XML and bad is not None:
        raise UserError(
            f"{path}: RDF/XML cannot hold the relation {bad!r}, whose IRI does not end in an XML "
            f"name. Write Turtle or N-Triples."
        )
    prefixes = PREFIXES if syntax == RdfFormat.TURTLE else None
    serialize(rdf_triples(graph), path, syntax, prefixes=prefixes)


def rdf_triples(graph: KnowledgeGraph) -> Iterator[Triple]:
    """Yield triples and labels as RDF, sorted by head."""
    labels = sorted((n, LABEL_RELATIONS[0], literal(t)) for n, t in graph.own_labels().items())
    return (triple_of_names(*statement) for statement in heapq.merge(graph, labels))


def _refuse_binary(path: Path) -> int:
    """Refuse a file with a zero byte; return the length of its byte order mark."""
    with open_bytes(path) as file:
        start = file.read(1 << 16)
    if (zero := start.find(b"\0")) >= 0:
        line = 1 + start.count(b"\n", 0, zero)
        raise UserError(
            f"{path}, line {line}: contains a zero byte, so this is "
            f"not a text file. Check the path and the format."
        )
    return len(BOM_UTF8) if start.startswith(BOM_UTF8) else 0


def _malformed(path: Path, syntax: RdfFormat, error: SyntaxError) -> UserError:
    """Return the error for a file that the parser refuses."""
    _refuse_functional_syntax(path)
    reason = re.sub(r"^Parser error .*?: ", "", " ".join(str(error.msg).split()))
    line = error.lineno
    if syntax == RdfFormat.RDF_XML and line is None:  # expat knows the line
        try:
            with open_bytes(path) as file:
                expat.ParserCreate().ParseFile(file)
        except expat.ExpatError as found:
            line, reason = found.lineno, expat.errors.messages[found.code]
    if "Invalid UTF-8" in reason:
        return UserError(
            f"{path}, line {line}: not UTF-8 ({reason}). "
            f"Convert the file, e.g. `iconv -f latin1 -t utf-8`."
        )
    if "LoadDocumentCallback" in reason:
        return UserError(
            f"{path}: the JSON-LD context is a remote document, and nothing is fetched from the "
            f"network. Write the context into the file."
        )
    location = f"{path}, line {line}" if line else str(path)
    return UserError(
        f"{location}: not well-formed {syntax.name}: {reason}. "
        f"Correct the file, or give the right format."
    )


def _refuse_functional_syntax(path: Path) -> None:
    with open_bytes(path) as file:
        for number, line in enumerate(file.read(20_000).splitlines(), 1):
            if line.lstrip().startswith((b"Prefix(", b"Ontology(")):
                raise UserError(
                    f"{path}, line {number}: this is OWL functional syntax, which is not RDF. "
                    f"Save it as RDF/XML or Turtle: in Protégé `File > Save as`, or "
                    f"`robot convert --input {path.name} --output {path.stem}.ttl`."
                )
