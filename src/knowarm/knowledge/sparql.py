"""SPARQL queries on a knowledge graph, evaluated by pyoxigraph in memory."""

import re
from dataclasses import dataclass

from pyoxigraph import Quad, QueryBoolean, QueryTriples, Store

from knowarm.errors import UserError
from knowarm.knowledge.builder import GraphBuilder
from knowarm.knowledge.formats.rdf import PREFIXES, rdf_triples
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.terms import name_of_term

EXAMPLE = "SELECT ?colour WHERE { :mug :hasColor ?colour }"

_NO_KEYWORDS = re.compile(
    r'"""(?:[^"\\]|\\.|"(?!""))*"""' r"|'''(?:[^'\\]|\\.|'(?!''))*'''"
    r'|"(?:[^"\\\n]|\\.)*"' r"|'(?:[^'\\\n]|\\.)*'"
    r'|<[^<>"{}|^`\\\s]*>' r"|#[^\n]*" r"|[?$]\w+" r"|:[\w.%~-]*",
    re.DOTALL,
)  # fmt: skip
"""Strings, IRIs, comments, variables and local names: text that holds no keyword."""


@dataclass(frozen=True)
class Answer:
    """Result of a query."""

    columns: tuple[str, ...]
    """Names of the variables; ("answer",) for ASK; empty for CONSTRUCT and DESCRIBE."""
    rows: tuple[tuple[str, ...], ...]
    """Names of entities and relations, sorted; "" where a variable is unbound."""
    graph: KnowledgeGraph | None = None
    """The graph of CONSTRUCT and DESCRIBE."""


def sparql(graph: KnowledgeGraph, query: str) -> Answer:
    """Run a query; the prefix `:` stands for plain names, as in `:mug :hasColor ?colour`.

    Args:
        graph: the graph, with its labels as rdfs:label.
        query: SELECT, ASK, CONSTRUCT or DESCRIBE. The common prefixes (rdf, rdfs, owl, skos,
            xsd) are declared.

    Raises:
        UserError: the query is malformed, or refers to other data with SERVICE or FROM.
    """
    _refuse_other_data(query)
    store = Store()
    store.bulk_extend(Quad(*triple) for triple in rdf_triples(graph))
    try:
        result = store.query(query, prefixes=PREFIXES)
        if isinstance(result, QueryBoolean):
            return Answer(("answer",), (("yes" if result else "no",),))
        if isinstance(result, QueryTriples):
            builder = GraphBuilder()
            for triple in result:
                builder.add_statement(*map(name_of_term, triple))
            return Answer((), (), builder.build())
        columns = tuple(variable.value for variable in result.variables)
        rows = [tuple("" if t is None else name_of_term(t) for t in row) for row in result]
    except SyntaxError as error:
        raise _malformed(error) from error
    return Answer(columns, tuple(sorted(rows)))


def _refuse_other_data(query: str) -> None:
    """Refuse queries that would read other data than the graph, over the network or not."""
    keywords = _NO_KEYWORDS.sub(" ", query)
    found = re.search(r"service|\bfrom\b", keywords, re.IGNORECASE)
    if found:
        raise UserError(
            f"SPARQL query: {found[0].upper()} refers to other data, but a query reads the given "
            f"graph only and nothing is fetched from the network. Leave it out, or load the other "
            f"graph and unite the two first."
        )


def _malformed(error: SyntaxError) -> UserError:
    place = re.match(r"error at (\d+):(\d+): (.*)", str(error.msg), re.DOTALL)
    if place is None:
        return UserError(f"SPARQL query: {error.msg}. Example: {EXAMPLE}")
    line, column, reason = place.groups()
    short = reason if len(reason) <= 60 else "unexpected symbol or end of the query"
    return UserError(
        f"SPARQL query, line {line}, column {column}: {short}. Check that every prefix is "
        f"declared with PREFIX. Example: {EXAMPLE}"
    )
