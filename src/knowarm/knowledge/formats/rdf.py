"""RDF files: Turtle, N-Triples, TriG, N-Quads, RDF/XML and JSON-LD, by pyoxigraph.

Nothing is fetched: a JSON-LD context must lie in the file itself.
"""

import heapq
import io
import re
import xml.sax
from collections import defaultdict, deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from itertools import chain
from pathlib import Path
from typing import IO, Any
from urllib.parse import urljoin, urlsplit
from xml.sax.handler import EntityResolver, feature_external_ges
from xml.sax.saxutils import XMLGenerator
from xml.sax.xmlreader import AttributesImpl

from pyoxigraph import (
    BlankNode,
    Literal,
    NamedNode,
    Quad,
    RdfFormat,
    Triple,
    parse,
    serialize,
)

from knowarm.errors import UserError, packages_of, warn
from knowarm.fence import ParserError, fenced
from knowarm.knowledge.formats.columns import probability
from knowarm.knowledge.formats.files import (
    open_bytes,
    open_compressed,
    to_utf8,
    zero_byte,
)
from knowarm.knowledge.formats.records import Statements
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.terms import (
    NAMESPACE,
    RDF,
    RDFS,
    Term,
    blank_names,
    iri_of_name,
    local_name,
    name_key,
    name_of_iri,
    triple_of_names,
)
from knowarm.reading import reading

PREFIXES = {
    "": NAMESPACE,
    "rdf": RDF,
    "rdfs": RDFS,
    "owl": "http://www.w3.org/2002/07/owl#",
    "skos": "http://www.w3.org/2004/02/skos/core#",
    "xsd": "http://www.w3.org/2001/XMLSchema#",
}
"""Prefixes of written Turtle, and of SPARQL queries where the file declares no others."""

_GENERATED = re.compile(r"_:[a-f][0-9a-f]{25,31}")
"""Random names that pyoxigraph gives to blank nodes without a name."""
_XML_NAME = re.compile(r"[^\W\d][\w.-]*$")
"""End of an IRI that RDF/XML can write as an element."""
LINES = (RdfFormat.N_TRIPLES, RdfFormat.N_QUADS)
"""Syntaxes with one statement per line."""
TERSE = (RdfFormat.TURTLE, RdfFormat.TRIG, RdfFormat.N3)
"""Syntaxes whose parser goes on behind a malformed term."""


NESTED = (RdfFormat.JSON_LD, RdfFormat.RDF_XML)
"""Syntaxes that nest; their files are parsed with limits of time and stack first."""
TRIPLE_TERM = b"<<"
"""Begins a triple within a triple in the other syntaxes, which nest in nothing else."""
CONFIDENCES = frozenset(
    map(name_key, ("confidence", "probability", "certainty", "weight"))
)
"""Relations that state the probability of a triple, from 0 to 1, in any spelling, "has" before it
or not."""
_REIFIES = RDF + "reifies"
_DECIMAL = NamedNode("http://www.w3.org/2001/XMLSchema#decimal")
Names = tuple[str, str, str]
"""Head, relation and tail as a file names them."""

OWL_SYNTAXES = {
    "ofn": "OWL functional syntax",
    "omn": "OWL Manchester syntax",
    "owx": "OWL/XML",
    "obo": "OBO",
}
"""Syntaxes of ontologies that are translated to RDF."""


def read_rdf(path: Path, syntax: RdfFormat) -> KnowledgeGraph:
    """Read an RDF file, plain or compressed.

    rdfs:label and skos:prefLabel become labels. Unnamed blank nodes are numbered in the order of
    the file, and named graphs are merged. Of what is said about triples (RDF 1.2), their confidence
    is read (see `CONFIDENCES`); the rest, and single statements with a bad IRI, are left out with a
    warning.
    """
    with reading(path, "Correct, copy or compress it again."):
        _refuse_binary(path)
        if syntax in NESTED or _has_triple_terms(path):
            with open_bytes(path) as file, suppress(ParserError):
                data = file.read()
                fenced(_parse, data, syntax, size=len(data))
        opened = partial(open_bytes, path)
        if syntax == RdfFormat.RDF_XML:
            with suppress(SyntaxError):
                return _read(opened, path, syntax)
            opened = partial(_plain_xml, path, syntax.name)
        try:
            return _read(opened, path, syntax)
        except SyntaxError as error:
            reason = _reason(error)
            raise _malformed(path, syntax.name, error.lineno, reason) from error


def read_owl(path: Path, syntax: Any) -> KnowledgeGraph:
    """Read an ontology in another syntax (see `OWL_SYNTAXES`).

    py-horned-owl translates it to RDF, by the mapping of the OWL 2 standard.
    """
    name = OWL_SYNTAXES[syntax]
    with packages_of("owl", f"{path} is no RDF and"):
        import pyhornedowl  # noqa: F401
    with reading(path, "Correct the file."):
        opened = partial(open_bytes, path)
        if syntax == "owx":  # py-horned-owl reads XML that is cut off for ever.
            opened = partial(_plain_xml, path, name)
        with opened() as file:
            text = file.read().decode()
        try:
            as_rdf = _owl_as_rdf(text, syntax)
        except ParserError as error:
            line = re.search(r"line_col: Pos\(\((\d+)", str(error))
            number = int(line[1]) if line else None
            raise _malformed(path, name, number, "it cannot be parsed") from error
        return _read(partial(io.BytesIO, as_rdf), path, RdfFormat.RDF_XML)


def _owl_as_rdf(text: str, syntax: str) -> bytes:
    """Translate an ontology to RDF/XML.

    OBO is translated without references to other databases if it cannot be read with them: many
    write them as no parser expects.
    """
    try:
        return fenced(_translated, text, syntax, size=len(text))
    except ParserError:
        if syntax != "obo":
            raise
    text = re.sub(r"^xref:.*$", "", text, flags=re.MULTILINE)
    return fenced(_translated, text, syntax, size=len(text))


def _translated(text: str, syntax: Any) -> bytes:
    import pyhornedowl

    ontology = pyhornedowl.open_ontology_from_string(text, syntax)
    return ontology.save_to_string("owl").encode()


def _has_triple_terms(path: Path) -> bool:
    with open_bytes(path) as file:
        return any(TRIPLE_TERM in line for line in file)


def _parse(data: bytes, syntax: RdfFormat) -> None:
    """Parse what overflows the stack, or takes the square of its time, if it nests deep enough."""
    deque(parse(data, format=syntax, lenient=True), maxlen=0)


def _read(
    opened: Callable[[], IO[bytes]],
    path: Path,
    syntax: RdfFormat,
    earlier: "_Quads | None" = None,
) -> KnowledgeGraph:
    """Read an RDF file; again, triple by triple, if malformed IRIs were found in it.

    It is read again as well if something was said about a term before the file told that it stands
    for a triple.

    Raises:
        SyntaxError: more than single statements are malformed.
    """
    statements = _Quads(path, earlier)
    builder = statements.builder
    base = None if syntax in LINES else path.absolute().as_uri()
    no_iri = 0
    prefixes = {}
    with opened() as file:
        quads = parse(file, format=syntax, base_iri=base, lenient=earlier is not None)
        for number, quad in enumerate(_sound(quads, syntax, statements.errors)):
            if number == 0:
                # The parser of RDF/XML forgets them at the end of their element.
                prefixes = quads.prefixes
            if syntax == RdfFormat.N3 and isinstance(quad.graph_name, BlankNode):
                raise UserError(
                    f"{path}: holds formulas in braces (N3), which state no facts. Leave them out."
                )
            if earlier is None or all(map(_is_sound, quad.triple)):
                statements.take(quad)
            else:
                no_iri += 1
        prefixes |= quads.prefixes
    builder.prefixes = {
        prefix: iri for prefix, iri in prefixes.items() if _is_absolute(iri)
    }
    is_late = not statements.triples.keys().isdisjoint(builder.entities)
    has_bad_iri = any("IRI" in _reason(error) for error in statements.errors)
    if earlier is None and (is_late or has_bad_iri):
        return _read(opened, path, syntax, statements)
    errors = (earlier or statements).errors
    malformed = len(statements.errors)
    if malformed + no_iri > len(builder.ids) // 30 + bool(builder.ids):
        raise errors[0]
    if errors:
        lines = ", ".join(str(error.lineno) for error in errors[:10])
        statements.left_out[
            f"triples with a malformed IRI and {malformed} malformed statements, in line {lines}: "
            f"{_reason(errors[0])}"
        ] = no_iri
    unnamed: dict[str, str] = defaultdict(blank_names(set(builder.entities)).__next__)

    def graph_name(name: str) -> str:
        if _GENERATED.fullmatch(name):
            return unnamed[name]
        return name_of_iri(name)

    graph = builder.build(new_name=graph_name)
    for names in set(chain.from_iterable(statements.triples.values())):
        head, relation, tail = map(graph_name, names)
        if (head, relation, tail) not in graph:
            statements.left_out["triples that are quoted (RDF 1.2) and not stated"] += 1
    statements.warn_of_left_out()
    graph.confidence = graph.own_confidence()
    return graph


class _Quads(Statements):
    """Statements of an RDF file, some of them about triples (RDF 1.2)."""

    def __init__(self, path: Path, earlier: "_Quads | None") -> None:
        super().__init__(path)
        self.errors: list[SyntaxError] = []
        self.triples = defaultdict[str, set[Names]](set)
        """The triples that a term stands for, by the term."""
        if earlier is not None:
            self.triples.update(earlier.triples)

    def take(self, quad: Quad) -> None:
        """Add a statement, or take what it says about a triple."""
        head = _name(quad.subject)
        relation = quad.predicate.value
        tail = quad.object
        if isinstance(tail, Triple):
            if relation == _REIFIES and not isinstance(tail.object, Triple):
                subject = _name(tail.subject)
                names = (subject, tail.predicate.value, _name(tail.object))
                self.triples[head].add(names)
                return
        elif head not in self.triples:
            self.builder.add_statement(head, relation, _name(tail))
            return
        confidence = _confidence(relation, tail)
        if confidence is None:
            self.left_out["statements about triples (RDF 1.2)"] += 1
            return
        for triple in self.triples[head]:
            self.note_confidence(triple, confidence)


def _confidence(relation: str, tail: Term | Triple) -> float | None:
    """Return the probability that a statement about a triple gives it; None of others."""
    word = name_key(local_name(relation)).removeprefix("has")
    if word not in CONFIDENCES or not isinstance(tail, Literal):
        return None
    return probability(tail.value)


def _sound(
    quads: Iterator[Quad], syntax: RdfFormat, errors: list[SyntaxError]
) -> Iterator[Quad]:
    """Yield the quads of statements in which no line or IRI is malformed; append the errors."""
    while True:
        try:
            yield from quads
            return
        except SyntaxError as error:
            of_term = syntax in TERSE and re.search("IRI|prefix", _reason(error))
            of_file = re.search("UTF-8|end of file", _reason(error))
            if of_file or not (syntax in LINES or of_term):
                raise
            errors.append(error.with_traceback(None))  # its frames hold the graph


def _is_sound(term: Term | Triple) -> bool:
    """Return whether a term is no malformed IRI."""
    return not isinstance(term, NamedNode) or _is_absolute(term.value)


def _is_absolute(iri: str) -> bool:
    """Return whether an IRI is well-formed and absolute."""
    with suppress(ValueError):
        return bool(NamedNode(iri))
    return False


def _name(term: Term | Triple) -> str:
    return term.value if isinstance(term, NamedNode) else str(term)


def _plain_xml(path: Path, syntax: str) -> IO[bytes]:
    """Return an XML file in UTF-8 without what the parser of RDF/XML knows in part.

    These are entities, and relative IRIs of bases and namespaces.
    """
    plain = io.BytesIO()
    parser = xml.sax.make_parser()
    parser.setFeature(feature_external_ges, True)  # else they would be left out
    parser.setEntityResolver(_NoOtherDocuments(path))
    parser.setContentHandler(_Absolute(plain, path.absolute().as_uri()))
    try:
        with open_compressed(path) as file:
            parser.parse(file)
    except xml.sax.SAXParseException as error:
        line = error.getLineNumber()
        raise _malformed(path, syntax, line, error.getMessage()) from error
    plain.seek(0)
    return plain


class _Absolute(XMLGenerator):
    """Writes XML with absolute IRIs of bases and namespaces."""

    def __init__(self, out: IO[bytes], document: str) -> None:
        super().__init__(out, "utf-8")
        self.bases = [document]

    def startElement(self, name: str, attrs: Any) -> None:
        """Write the start of an element, whose base is relative to that around it."""
        values = dict(attrs)
        base = urljoin(self.bases[-1], values.get("xml:base", ""))
        self.bases.append(base)
        if "xml:base" in values:
            values["xml:base"] = base
        for key, iri in values.items():
            if key.startswith("xmlns") and iri and not urlsplit(iri).scheme:
                # urljoin drops a "#" at the end.
                end = "#" * iri.endswith("#")
                values[key] = urljoin(base, iri).rstrip("#") + end
        super().startElement(name, AttributesImpl(values))

    def endElement(self, name: str) -> None:
        """Write the end of an element."""
        self.bases.pop()
        super().endElement(name)


class _NoOtherDocuments(EntityResolver):
    """Refuses entities that are defined elsewhere."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def resolveEntity(self, public: str | None, system: str) -> str:
        """Refuse an entity in another document."""
        raise UserError(
            f"{self.path}: refers to another document, {system!r}, and only the given one is read. "
            "Write what it defines into the file."
        )


def write_rdf(graph: KnowledgeGraph, path: Path, syntax: RdfFormat) -> None:
    """Write triples and labels, sorted by head. Entities without either are not in RDF."""
    for relation in graph.relations_used:
        if syntax == RdfFormat.RDF_XML and not _XML_NAME.search(iri_of_name(relation)):
            raise UserError(
                f"{path}: RDF/XML cannot hold the relation {relation!r}, whose IRI does not end in "
                f"an XML name. Write Turtle or N-Triples."
            )
    statements = rdf_triples(graph)
    count = len(graph.own_confidence())
    holds_confidence = syntax in (*TERSE, *LINES)
    if holds_confidence:
        statements = chain(statements, _annotations(graph))
    if count:
        what = "is left out; Turtle, N-Triples and tables hold it"
        if holds_confidence:
            what = "is annotated as in RDF 1.2, which readers of RDF 1.1 refuse"
        warn(f"{path}: the confidence of {count} triples {what}.")
    prefixes = PREFIXES if syntax == RdfFormat.TURTLE else None
    serialize(statements, path, syntax, prefixes=prefixes)


def rdf_triples(graph: KnowledgeGraph) -> Iterator[Triple]:
    """Yield triples and labels as RDF, sorted by head."""
    for statement in heapq.merge(graph, graph.label_statements()):
        yield triple_of_names(*statement)


def _annotations(graph: KnowledgeGraph) -> Iterator[Triple]:
    """Yield the confidence of triples as annotations of RDF 1.2."""
    free = blank_names(set(graph.entities))
    confidence = graph.own_confidence()
    for triple, name in zip(sorted(confidence), free, strict=False):
        reifier = BlankNode(name.removeprefix("_:"))
        share = Literal(f"{confidence[triple]:.9g}", datatype=_DECIMAL)
        yield Triple(reifier, NamedNode(_REIFIES), triple_of_names(*triple))
        yield Triple(reifier, NamedNode(NAMESPACE + "confidence"), share)


def _refuse_binary(path: Path) -> None:
    """Refuse a file with a zero byte."""
    with open_bytes(path) as file:
        before, zero, _ = file.read(1 << 16).partition(b"\0")
    if zero:
        raise zero_byte(path, 1 + before.count(b"\n"))


def _reason(error: SyntaxError) -> str:
    """Return what the parser says is wrong."""
    return re.sub(r"^Parser error .*?: ", "", " ".join(str(error.msg).split()))


def _malformed(path: Path, syntax: str, line: int | None, reason: str) -> UserError:
    """Return the error for a file that a parser refuses."""
    if "Invalid UTF-8" in reason:
        return UserError(
            f"{path}, line {line}: not UTF-8 ({reason}). "
            f"Convert the file: {to_utf8(path)}"
        )
    if "LoadDocumentCallback" in reason:
        return UserError(
            f"{path}: the JSON-LD context is a remote document, and nothing is fetched from the "
            f"network. Write the context into the file."
        )
    where = f"{path}, line {line}" if line else str(path)
    return UserError(
        f"{where}: not well-formed {syntax}: {reason}. "
        f"Correct the file, or give the right format."
    )
