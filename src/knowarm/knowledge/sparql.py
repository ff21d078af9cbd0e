"""A graph and a SPARQL query go in; rows, or a graph, come out, through rdflib."""

from dataclasses import dataclass

import rdflib
from pyparsing import ParseBaseException
from rdflib.namespace import RDFS

from knowarm.errors import UserError
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.read.rdf import graph_of_rdflib, name_of_term
from knowarm.knowledge.term import NAMESPACE, iri_of_name, is_blank, is_literal, literal_parts

MAX_TRIPLES = 2_000_000
"""Above this rdflib's copy of the graph would take gigabytes."""


@dataclass(frozen=True)
class Answer:
    """What a query found."""

    columns: tuple[str, ...]
    """Names of the variables; ("answer",) for ASK; empty for CONSTRUCT and DESCRIBE."""
    rows: tuple[tuple[str, ...], ...]
    """Names of the graph, "" where a variable is unbound."""
    graph: KnowledgeGraph | None = None
    """The graph of CONSTRUCT and DESCRIBE."""


def sparql(graph: KnowledgeGraph, query: str) -> Answer:
    """Ask a graph; the prefix `:` stands for plain names, as in `:mug :hasColor ?colour`.

    Raises:
        UserError: the query is not well formed, or the graph is too large for rdflib.
    """
    store = rdflib_graph(graph)
    try:
        result = store.query(query, initNs={"": rdflib.Namespace(NAMESPACE)})
    except ParseBaseException as error:
        raise UserError(
            f"SPARQL query, line {error.lineno}, column {error.column}: {error.msg}. "
            f"Example: SELECT ?colour WHERE {{ :mug :hasColor ?colour }}"
        ) from error
    except Exception as error:  # an unknown prefix is a bare Exception in rdflib
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise UserError(f"SPARQL query: {reason}. Declare prefixes with PREFIX.") from error
    if result.type == "ASK":
        return Answer(("answer",), (("yes" if result.askAnswer else "no",),))
    if result.type in ("CONSTRUCT", "DESCRIBE"):
        assert result.graph is not None
        return Answer((), (), graph_of_rdflib(result.graph))
    columns = tuple(str(variable) for variable in result.vars or ())
    rows = [
        tuple("" if term is None else name_of_term(term) for term in row)  # type: ignore[union-attr]
        for row in result
    ]
    return Answer(columns, tuple(sorted(rows)))


def rdflib_graph(graph: KnowledgeGraph) -> rdflib.Graph:
    """Copy a graph, with its labels, to rdflib.

    Raises:
        UserError: the graph is too large.
    """
    if len(graph) > MAX_TRIPLES:
        raise UserError(
            f"SPARQL runs in rdflib, which takes at most {MAX_TRIPLES:,} triples here; the graph "
            f"has {len(graph):,}. Select a part first, with `knowarm knowledge subgraph`."
        )
    store = rdflib.Graph()
    for triple in graph:
        store.add(tuple(_term(name) for name in triple))  # type: ignore[arg-type]
    for name, label in graph.own_labels().items():
        store.add((_term(name), RDFS.label, rdflib.Literal(label)))
    return store


def _term(name: str) -> rdflib.term.Identifier:
    if is_literal(name):
        text, language, datatype = literal_parts(name)
        kind = None if datatype is None else rdflib.URIRef(datatype)
        return rdflib.Literal(text, lang=language, datatype=kind)
    return rdflib.BNode(name[2:]) if is_blank(name) else rdflib.URIRef(iri_of_name(name))
