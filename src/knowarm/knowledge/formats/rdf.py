"""RDF files: Turtle, N-Triples, TriG, N-Quads, RDF/XML and JSON-LD, by pyoxigraph.

Nothing is fetched: a JSON-LD context must lie in the file itself.
"""

import heapq
import io
import re
import xml.sax
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from itertools import chain, islice
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
from knowarm.knowledge.formats.files import open_bytes, open_compressed, to_utf8
from knowarm.knowledge.graph.builder import GraphBuilder
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
_OWL_PARSER = """
import pyhornedowl
def parse(data):
    ontology = pyhornedowl.open_ontology_from_string(data.decode(), "{syntax}")
    return ontology.save_to_string("owl").encode()
"""
_JSON_LD_PARSER = """
import pyoxigraph
def parse(data):
    for _ in pyoxigraph.parse(data, format=pyoxigraph.RdfFormat.JSON_LD, lenient=True):
        pass
    return b""
"""
"""Parsers that are run in a `fenced` process: deep input ends them."""
LINES = (RdfFormat.N_TRIPLES, RdfFormat.N_QUADS)
"""Syntaxes with one statement per line."""
TERSE = (RdfFormat.TURTLE, RdfFormat.TRIG, RdfFormat.N3)
"""Syntaxes whose parser goes on behind a malformed term."""


CONFIDENCES = frozenset(
    map(name_key, ("confidence", "probability", "certainty", "weight"))
)
"""Relations that state the probability of a triple, from 0 to 1, in any spelling, "has" before it
or not."""
_REIFIES = RDF + "reifies"

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
        if syntax == RdfFormat.JSON_LD:
            with open_bytes(path) as file, suppress(ParserError):
                fenced(_JSON_LD_PARSER, file.read())
        try:
            try:
                return _read(partial(open_bytes, path), path, syntax)
            except SyntaxError:
                if syntax != RdfFormat.RDF_XML:
                    raise
            return _read(partial(_plain_xml, path), path, syntax)
        except xml.sax.SAXParseException as error:
            raise _malformed(
                path, syntax, error.getLineNumber(), error.getMessage()
            ) from error
        except SyntaxError as error:
            raise _malformed(path, syntax, error.lineno, _reason(error)) from error


def read_owl(path: Path, syntax: Any) -> KnowledgeGraph:
    """Read an ontology in another syntax (see `OWL_SYNTAXES`).

    py-horned-owl translates it to RDF, by the mapping of the OWL 2 standard.
    """
    with packages_of("owl", f"{path} is no RDF and"):
        import pyhornedowl  # noqa: F401
    with reading(path, "Correct the file."):
        # py-horned-owl reads XML that is cut off for ever.
        opened = _plain_xml if syntax == "owx" else open_bytes
        try:
            with opened(path) as file:
                text = file.read().decode()
        except xml.sax.SAXParseException as error:
            raise UserError(
                f"{path}, line {error.getLineNumber()}: not well-formed {OWL_SYNTAXES[syntax]}: "
                f"{error.getMessage()}. Correct, copy or compress it again."
            ) from error
        try:
            as_rdf = _owl_as_rdf(text, syntax)
        except ParserError as error:
            line = re.search(r"line_col: Pos\(\((\d+)", str(error))
            where = str(path)
            if line is not None:
                where += f", line {line[1]}"
            raise UserError(
                f"{where}: not well-formed {OWL_SYNTAXES[syntax]}. Correct it."
            ) from error
        return _read(partial(io.BytesIO, as_rdf), path, RdfFormat.RDF_XML)


def _owl_as_rdf(text: str, syntax: str) -> bytes:
    """Translate an ontology to RDF/XML; OBO without references, if it cannot be read with them."""
    parser = _OWL_PARSER.format(syntax=syntax)
    try:
        return fenced(parser, text.encode())
    except ParserError:
        plain = _without_references(text)
        if syntax != "obo" or plain == text:
            raise
        return fenced(parser, plain.encode())


def _without_references(text: str) -> str:
    """Return OBO without references to other databases, which many write as no parser expects."""
    return re.sub(r"^xref:.*$", "", text, flags=re.MULTILINE)


def _read(
    opened: Callable[[], IO[bytes]],
    path: Path,
    syntax: RdfFormat,
    bad_iris: Sequence[SyntaxError] = (),
    reified: "_Reified | None" = None,
) -> KnowledgeGraph:
    """Read an RDF file; again, triple by triple, if malformed IRIs were found in it.

    It is read again as well if something was said about a term before the file told that it stands
    for a triple.

    Raises:
        SyntaxError: more than single statements are malformed.
    """
    builder = GraphBuilder()
    errors = list(bad_iris)
    about = reified or _Reified()
    base = None if syntax in LINES else path.absolute().as_uri()
    no_iri = 0
    with opened() as file:
        quads = parse(file, format=syntax, base_iri=base, lenient=bool(bad_iris))
        sound = _sound(quads, syntax, errors)
        first = list(islice(sound, 1))
        # The parser of RDF/XML forgets the prefixes at the end of their element.
        prefixes = quads.prefixes
        for quad in chain(first, sound):
            head = quad.subject
            tail = quad.object
            relation = quad.predicate.value
            if syntax == RdfFormat.N3 and isinstance(quad.graph_name, BlankNode):
                raise UserError(
                    f"{path}: holds formulas in braces (N3), which state no facts. Leave them out."
                )
            if bad_iris and not all(map(_is_sound, (head, quad.predicate, tail))):
                no_iri += 1
            elif (
                type(head) is NamedNode
                and type(tail) is NamedNode
                and not about.triples
            ):  # most: fast
                builder.add(head.value, relation, tail.value)
            elif not about.takes(quad):
                builder.add_statement(_name(head), relation, _name(tail))
        builder.prefixes = _absolute(prefixes | quads.prefixes)
    if not bad_iris and any("IRI" in _reason(error) for error in errors):
        return _read(opened, path, syntax, errors)
    if reified is None and not about.triples.keys().isdisjoint(builder.entities):
        return _read(opened, path, syntax, bad_iris, _Reified(about.triples))
    malformed = len(errors) - len(bad_iris)
    if malformed + no_iri > len(builder.ids) // 30 + bool(builder.ids):
        raise errors[0]
    if errors:
        lines = ", ".join(str(error.lineno) for error in errors[:10])
        warn(
            f"{path}: {no_iri} triples with a malformed IRI and {malformed} malformed statements "
            f"are left out, in line {lines}: {_reason(errors[0])}."
        )
    builder.confidence = about.confidence
    unnamed: dict[str, str] = defaultdict(blank_names(set(builder.entities)).__next__)

    def graph_name(name: str) -> str:
        if _GENERATED.fullmatch(name):
            return unnamed[name]
        return name_of_iri(name)

    graph = builder.build(new_name=graph_name)
    quoted = set[tuple[str, str, str]]()
    for names in chain.from_iterable(about.triples.values()):
        triple = (graph_name(names[0]), graph_name(names[1]), graph_name(names[2]))
        if triple not in graph:
            quoted.add(triple)
    if about.left_out:
        warn(
            f"{path}: what is said about {about.left_out} triples (RDF 1.2) is left out."
        )
    if quoted:
        warn(
            f"{path}: {len(quoted)} triples are quoted (RDF 1.2) and not stated, and are left out."
        )
    graph.confidence = graph.own_confidence()
    return graph


class _Reified:
    """What is said about triples (RDF 1.2).

    Attributes:
        triples: the triples that a term stands for, by the term.
        confidence: the probability of triples.
        left_out: how many statements about triples say something else.
    """

    def __init__(
        self, triples: Mapping[str, list[tuple[str, str, str]]] | None = None
    ) -> None:
        self.triples = defaultdict[str, list[tuple[str, str, str]]](list, triples or {})
        self.confidence: dict[tuple[str, str, str], float] = {}
        self.left_out = 0

    def takes(self, quad: Quad) -> bool:
        """Take a statement about a triple; return False of others."""
        tail = quad.object
        if isinstance(tail, Triple):
            self._stand_for(quad, tail)
            return True
        about = self.triples.get(_name(quad.subject))
        if about is None:
            return False
        confidence = _confidence(quad)
        self.left_out += confidence is None
        for triple in about:
            if confidence is not None:
                self.confidence[triple] = max(
                    confidence, self.confidence.get(triple, 0.0)
                )
        return True

    def _stand_for(self, quad: Quad, triple: Triple) -> None:
        if quad.predicate.value != _REIFIES or isinstance(triple.object, Triple):
            self.left_out += 1
            return
        names = (_name(triple.subject), triple.predicate.value, _name(triple.object))
        self.triples[_name(quad.subject)].append(names)


def _confidence(quad: Quad) -> float | None:
    """Return the probability that a statement about a triple gives it; None of others."""
    word = name_key(local_name(quad.predicate.value))
    is_confidence = word in CONFIDENCES or word.removeprefix("has") in CONFIDENCES
    if is_confidence and isinstance(quad.object, Literal):
        with suppress(ValueError):
            number = float(quad.object.value)
            if 0 <= number <= 1:
                return number
    return None


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
            errors.append(error)


def _absolute(prefixes: Mapping[str, str]) -> dict[str, str]:
    """Return the prefixes that stand for the beginning of an absolute IRI."""
    absolute = dict[str, str]()
    for prefix, iri in prefixes.items():
        with suppress(ValueError):
            absolute[prefix] = NamedNode(iri).value
    return absolute


def _is_sound(term: Term | Triple) -> bool:
    """Return whether a term is no malformed IRI."""
    with suppress(ValueError):
        return not isinstance(term, NamedNode) or bool(NamedNode(term.value))
    return False


def _name(term: Term | Triple) -> str:
    return term.value if isinstance(term, NamedNode) else str(term)


def _plain_xml(path: Path) -> IO[bytes]:
    """Return an XML file in UTF-8 without what the parser of RDF/XML knows in part.

    These are entities, and relative IRIs of bases and namespaces.
    """
    plain = io.BytesIO()
    parser = xml.sax.make_parser()
    parser.setFeature(feature_external_ges, True)  # else they would be left out
    parser.setEntityResolver(_NoOtherDocuments(path))
    parser.setContentHandler(_Absolute(plain, path.absolute().as_uri()))
    with open_compressed(path) as file:
        parser.parse(file)
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
        base = self.bases[-1]
        if "xml:base" in values:
            base = urljoin(base, values["xml:base"])
            values["xml:base"] = base
        self.bases.append(base)
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
    doubtful = graph.own_confidence()
    if doubtful:
        warn(
            f"{path}: the confidence of {len(doubtful)} triples is left out; tables have a column."
        )
    prefixes = PREFIXES if syntax == RdfFormat.TURTLE else None
    serialize(rdf_triples(graph), path, syntax, prefixes=prefixes)


def rdf_triples(graph: KnowledgeGraph) -> Iterator[Triple]:
    """Yield triples and labels as RDF, sorted by head."""
    for statement in heapq.merge(graph, graph.label_statements()):
        yield triple_of_names(*statement)


def _refuse_binary(path: Path) -> None:
    """Refuse a file with a zero byte."""
    with open_bytes(path) as file:
        start = file.read(1 << 16)
    zero = start.find(b"\0")
    if zero >= 0:
        line = 1 + start.count(b"\n", 0, zero)
        raise UserError(
            f"{path}, line {line}: contains a zero byte, so this is "
            f"not a text file. Check the path and the format."
        )


def _reason(error: SyntaxError) -> str:
    """Return what the parser says is wrong."""
    return re.sub(r"^Parser error .*?: ", "", " ".join(str(error.msg).split()))


def _malformed(
    path: Path, syntax: RdfFormat, line: int | None, reason: str
) -> UserError:
    """Return the error for a file that the parser refuses."""
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
        f"{where}: not well-formed {syntax.name}: {reason}. "
        f"Correct the file, or give the right format."
    )
