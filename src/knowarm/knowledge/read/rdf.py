"""A file of RDF goes in, parsed by rdflib; a KnowledgeGraph comes out."""

from pathlib import Path

import rdflib
from rdflib.plugins.parsers.notation3 import BadSyntax
from rdflib.term import BNode, Literal, Node

from knowarm.errors import UserError
from knowarm.knowledge.builder import GraphBuilder
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.read.label_choice import LabelChoice
from knowarm.knowledge.term import literal, name_of_iri

MAX_BYTES = 400_000_000
"""Above this rdflib would need tens of gigabytes and an hour; N-Triples are streamed instead."""

SYNTAXES = {"turtle": "Turtle", "xml": "RDF/XML", "json-ld": "JSON-LD", "nt": "N-Triples"}
"""rdflib's name of each syntax, and ours."""


def read_rdf(path: Path, syntax: str) -> KnowledgeGraph:
    """Read Turtle, RDF/XML or JSON-LD; rdfs:label and skos:prefLabel become labels.

    Raises:
        UserError: the file is not well formed (with the line where the parser gives one), is
            OWL in functional syntax, or is too large for rdflib.
    """
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise UserError(
            f"{path} has {size / 1e9:.1f} GB; {SYNTAXES[syntax]} is read whole and at most "
            f"{MAX_BYTES / 1e9:.1f} GB. Convert it to N-Triples (.nt), which is read line by line, "
            f"for example with `rapper -o ntriples`."
        )
    _refuse_functional_syntax(path)
    parsed = rdflib.Graph()
    try:
        parsed.parse(path, format=syntax)
    except BadSyntax as error:
        reason = error._why.splitlines()[0]
        raise UserError(
            f"{path}, line {error.lines + 1}: not well-formed {SYNTAXES[syntax]}: {reason}. "
            f"Mend that line, or name the right format with --format."
        ) from error
    except Exception as error:  # each rdflib parser raises its own kinds
        line = _line_of(error)
        place = f"{path}, line {line}" if line else str(path)
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise UserError(
            f"{place}: not well-formed {SYNTAXES[syntax]}: {reason}. "
            f"Mend the file, or name the right format with --format."
        ) from error
    return graph_of_rdflib(parsed)


def graph_of_rdflib(parsed: rdflib.Graph) -> KnowledgeGraph:
    """Turn an rdflib graph into a KnowledgeGraph."""
    builder, labels = GraphBuilder(), LabelChoice()
    for head, relation, tail in parsed:
        if labels.take(name_of_term(head), str(relation), name_of_term(tail)):
            continue
        builder.add(name_of_term(head), name_of_term(relation), name_of_term(tail))
    return builder.build(labels.chosen())


def name_of_term(term: Node) -> str:
    """Return the graph's name of an rdflib term."""
    if isinstance(term, Literal):
        datatype = None if term.datatype is None else str(term.datatype)
        return literal(str(term), language=term.language, datatype=datatype)
    return f"_:{term}" if isinstance(term, BNode) else name_of_iri(str(term))


def _line_of(error: Exception) -> int | None:
    """Find a line number in a parser's error: XML's and JSON's have one each."""
    if hasattr(error, "getLineNumber"):
        return int(error.getLineNumber())
    number = getattr(error, "lineno", None)
    return int(number) if number else None


def _refuse_functional_syntax(path: Path) -> None:
    with path.open("rb") as file:
        for number, line in enumerate(file.read(20_000).splitlines(), 1):
            if line.lstrip().startswith((b"Prefix(", b"Ontology(")):
                raise UserError(
                    f"{path}, line {number}: this is OWL functional syntax, which is not RDF. "
                    f"Save it as RDF/XML or Turtle: in Protégé `File > Save as`, or "
                    f"`robot convert --input {path.name} --output {path.stem}.ttl`."
                )
