"""RDF files: Turtle, N-Triples, RDF/XML and JSON-LD, parsed and serialized by pyoxigraph.

Nothing is fetched: a JSON-LD context must lie in the file itself, and external XML entities are
refused.
"""

import heapq
import re
from collections.abc import Iterator
from pathlib import Path
from typing import IO, cast
from xml.parsers import expat

from pyoxigraph import BlankNode, NamedNode, RdfFormat, Triple, parse, serialize

from knowarm.errors import UserError
from knowarm.knowledge.builder import GraphBuilder
from knowarm.knowledge.formats.lines import READ_ERRORS, open_bytes, unreadable
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.terms import (
    LABEL_RELATIONS,
    NAMESPACE,
    Term,
    iri_of_name,
    literal,
    name_of_iri,
    name_of_term,
    triple_of_names,
)
from knowarm.reading import MAX_JSON, reading

PREFIXES = {
    "": NAMESPACE,
    "rdf": "http://www.w3.org/1999/02/22-rdf-syntax-ns#",
    "rdfs": "http://www.w3.org/2000/01/rdf-schema#",
    "owl": "http://www.w3.org/2002/07/owl#",
    "skos": "http://www.w3.org/2004/02/skos/core#",
    "xsd": "http://www.w3.org/2001/XMLSchema#",
}
"""Prefixes of written Turtle and of SPARQL queries."""

_GENERATED = re.compile(r"[a-f][0-9a-f]{25,31}")
"""Random ids that pyoxigraph gives to blank nodes without a name."""


MAX_GAP = 4 * 2**20
"""Most bytes without a complete statement; a failed attempt is repeated from its start."""

MAX_DEPTH, MAX_ENTITY = 200, 1_000
"""Deepest nesting of XML elements and JSON values, and longest XML entity. The parsers call
themselves for every level, and the process ends where its stack does."""

MAX_QUOTED = 1_000
"""Most triples inside triples (RDF-star) without a complete statement."""

_JSON_TOKEN = re.compile(rb'"(?:[^"\\]|\\.)*"?|[\[{]|[\]}]', re.DOTALL)

_XML_NAME = re.compile(r"[^\W\d][\w.-]*$")
"""End of an IRI that RDF/XML can write as an element."""


def read_rdf(path: Path, syntax: RdfFormat) -> KnowledgeGraph:
    """Read an RDF file, plain or compressed (.gz, .bz2, .xz).

    rdfs:label and skos:prefLabel become labels. Unnamed blank nodes are numbered in the order of
    the file, and named graphs are merged.

    Raises:
        UserError: the file is malformed (with the line, where it is known), is OWL in functional
            syntax, refers to a remote context, or cannot be decompressed.
    """
    builder = GraphBuilder()
    unnamed: dict[str, str] = {}
    base = None if syntax == RdfFormat.N_TRIPLES else path.absolute().as_uri()

    def name(term: Term | Triple) -> str:
        if isinstance(term, NamedNode):
            return term.value  # renamed at the end, once per name
        if isinstance(term, BlankNode) and _GENERATED.fullmatch(term.value):
            return unnamed.setdefault(term.value, f"_:unnamed{len(unnamed)}")
        return name_of_term(term)

    try:
        _refuse_binary(path)
        if syntax == RdfFormat.RDF_XML:
            _check_xml(path)
        if syntax == RdfFormat.JSON_LD:
            _check_json(path)
        add = builder.add
        with open_bytes(path) as file:
            source = _Source(file, path, MAX_JSON if syntax == RdfFormat.JSON_LD else MAX_GAP)
            for quad in parse(cast(IO[bytes], source), format=syntax, base_iri=base):
                source.gap = 0
                head, tail, relation = quad.subject, quad.object, quad.predicate.value
                if type(head) is NamedNode and type(tail) is NamedNode:  # most triples: fast
                    add(head.value, relation, tail.value)
                else:
                    builder.add_statement(name(head), relation, name(tail))
    except UserError:
        raise
    except SyntaxError as error:
        raise _malformed(path, syntax, error) from error
    except READ_ERRORS as error:
        raise unreadable(path, error) from error
    with reading(path, "Correct the file."):
        builder.rename(name_of_iri)
        return builder.build()


class _Source:
    """File that the parser reads, as long as statements come out of it."""

    def __init__(self, file: IO[bytes], path: Path, most: int) -> None:
        self._file, self._path, self._most = file, path, most
        self.gap = 0
        """Bytes read since the last statement."""
        self._quoted = 0

    def read(self, size: int = -1) -> bytes:
        """Read at most ``size`` bytes.

        Raises:
            UserError: too many bytes hold no statement.
        """
        data = self._file.read(size)
        self._quoted = data.count(b"<<") + (self._quoted if self.gap else 0)
        if self._quoted > MAX_QUOTED:
            raise UserError(
                f"{self._path}: more than {MAX_QUOTED:,} triples inside triples (RDF-star), which "
                f"a knowledge graph cannot hold. State them as plain triples."
            )
        self.gap += len(data)
        if self.gap > self._most:
            raise UserError(
                f"{self._path}: {self._most / 2**20:.0f} MiB in a row hold no complete statement, "
                f"which no graph needs. Look for a string, comment or list that does not end."
            )
        return data


def write_rdf(graph: KnowledgeGraph, path: Path, syntax: RdfFormat) -> None:
    """Write triples and labels, sorted by head. Entities without either are not in RDF.

    Raises:
        UserError: RDF/XML cannot hold one of the relations.
    """
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


def _refuse_binary(path: Path) -> None:
    with open_bytes(path) as file:
        start = file.read(1 << 16)
    if (place := start.find(b"\0")) >= 0:
        line = 1 + start.count(b"\n", 0, place)
        raise UserError(
            f"{path}, line {line}: contains a zero byte, so this is "
            f"not a text file. Check the path and the format."
        )


def _malformed(path: Path, syntax: RdfFormat, error: SyntaxError) -> UserError:
    """Return the error for a file that the parser refuses."""
    _refuse_functional_syntax(path)
    reason = re.sub(r"^Parser error .*?: ", "", " ".join(str(error.msg).split()))
    line = error.lineno
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
    if line is None and syntax == RdfFormat.RDF_XML:
        line, reason = _xml_error(path) or (line, reason)
    place = f"{path}, line {line}" if line else str(path)
    return UserError(
        f"{place}: not well-formed {syntax.name}: {reason}. "
        f"Correct the file, or give the right format."
    )


def _check_xml(path: Path) -> None:
    """Refuse XML that would take the parser very long: deep nesting, entities of entities.

    Raises:
        UserError: an element is nested too deeply, or an entity is longer than a name or refers to
            another one.
    """
    parser, depth = expat.ParserCreate(), 0

    def refuse(what: str) -> None:
        raise UserError(
            f"{path}, line {parser.CurrentLineNumber}: {what}, which no graph needs. Correct the "
            f"file, or write it as Turtle."
        )

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > MAX_DEPTH:
            refuse(f"elements are nested more than {MAX_DEPTH} deep")

    def end(name: str) -> None:
        nonlocal depth
        depth -= 1

    def entity(name: str, is_parameter: bool, value: str | None, *rest: str | None) -> None:
        if value is None:
            refuse(f"the entity {name!r} lies in another document")
        elif "&" in value or "%" in value or len(value) > MAX_ENTITY:
            refuse(f"the entity {name!r} is longer than {MAX_ENTITY} letters or refers to others")

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.EntityDeclHandler = entity
    try:
        with open_bytes(path) as file:
            parser.ParseFile(file)
    except expat.ExpatError:
        return  # reading the file reports it
    except LookupError as error:  # an unknown encoding
        raise unreadable(path, error) from error


def _check_json(path: Path) -> None:
    """Refuse JSON that is nested too deeply for the parser.

    Raises:
        UserError: it is, or it is larger than the parser may read.
    """
    with open_bytes(path) as file:
        data = file.read(MAX_JSON + 1)
    if len(data) > MAX_JSON:
        raise UserError(
            f"{path}: JSON-LD of more than {MAX_JSON / 2**20:.0f} MiB is not read. Write the graph "
            f"as N-Triples."
        )
    depth = 0
    for token in _JSON_TOKEN.finditer(data):
        bracket = token[0][:1]
        depth += (bracket in b"[{") - (bracket in b"]}")
        if depth > MAX_DEPTH:
            line = 1 + data.count(b"\n", 0, token.start())
            raise UserError(
                f"{path}, line {line}: values are nested more than {MAX_DEPTH} deep, which no "
                f"graph needs. Correct the file, or write it as Turtle."
            )


def _xml_error(path: Path) -> tuple[int, str] | None:
    """Return line and reason of the first place that is not well-formed XML."""
    try:
        with open_bytes(path) as file:
            expat.ParserCreate().ParseFile(file)
    except expat.ExpatError as error:
        return error.lineno, expat.errors.messages[error.code]
    return None


def _refuse_functional_syntax(path: Path) -> None:
    with open_bytes(path) as file:
        for number, line in enumerate(file.read(20_000).splitlines(), 1):
            if line.lstrip().startswith((b"Prefix(", b"Ontology(")):
                raise UserError(
                    f"{path}, line {number}: this is OWL functional syntax, which is not RDF. "
                    f"Save it as RDF/XML or Turtle: in Protégé `File > Save as`, or "
                    f"`robot convert --input {path.name} --output {path.stem}.ttl`."
                )
