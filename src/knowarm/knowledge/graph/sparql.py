"""SPARQL queries on a knowledge graph, evaluated by pyoxigraph in a child process."""

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from functools import partial
from typing import IO, Any, NamedTuple

from pyoxigraph import (
    QueryBoolean,
    QueryResultsFormat,
    RdfFormat,
    parse,
    parse_query_results,
    serialize,
)

from knowarm.errors import UserError
from knowarm.knowledge.formats.oxigraph import run_oxigraph
from knowarm.knowledge.formats.rdf import PREFIXES, rdf_triples
from knowarm.knowledge.graph.builder import GraphBuilder
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.terms import blank_names, name_of_term
from knowarm.reading import one_line

EXAMPLE = "SELECT ?colour WHERE { :mug :hasColor ?colour }"
MAX_ROWS = 1_000_000
"""Most rows of an answer."""
MAX_QUERY = 20_000
"""Most characters of a query."""
_QUIET = re.compile(
    r"""<[^<>"{}|^`\\\s]*>|"{3}(?:[^\\]|\\.)*?"{3}|'{3}(?:[^\\]|\\.)*?'{3}|"""
    r""""(?:[^"\\\n]|\\.)*"|'(?:[^'\\\n]|\\.)*'|\\.|(\#[^\n]*)""",
    re.DOTALL,
)
"""IRIs, strings, escaped characters and, as a group, comments."""
_SERVICE = re.compile(r"([:?$@]?)[\w%-]*?(service)\s*(?:silent\s*)?[^\s{}]*\s*\{", re.IGNORECASE)
_FROM = re.compile(r"([:?$@]?)\b(from)\b(?!:)", re.IGNORECASE)
"""Keywords that refer to other data; after the first group it is the name of a thing."""


class Answer(NamedTuple):
    """Result of a query."""

    # Names of the variables; ("answer",) for ASK; empty for CONSTRUCT and DESCRIBE
    columns: tuple[str, ...]
    # Names of entities and relations, sorted; "" where a variable is unbound
    rows: tuple[tuple[str, ...], ...]
    graph: KnowledgeGraph | None = None  # The graph of CONSTRUCT and DESCRIBE


def sparql(graph: KnowledgeGraph, query: str) -> Answer:
    """Run a query; the prefix `:` stands for plain names, as in `:mug :hasColor ?colour`."""
    text = _QUIET.sub(lambda found: " " if found[1] else "_", query)
    found = [*_SERVICE.finditer(text), *_FROM.finditer(text.split("{")[0])]
    if word := next((each[2] for each in found if not each[1]), None):
        raise UserError(
            f"SPARQL query: {word.upper()} refers to other data, but a query reads the given "
            f"graph only and nothing is fetched from the network. Leave it out, or load the other "
            f"graph and unite the two first."
        )
    if len(query) > MAX_QUERY:
        raise UserError(f"SPARQL query: it is longer than {MAX_QUERY:,} characters.")
    try:
        triples = partial(serialize, rdf_triples(graph), format=RdfFormat.N_TRIPLES)
        with run_oxigraph(triples, query=query, prefixes=PREFIXES) as output:
            return _answer(output, graph)
    except UserError:
        raise
    except SyntaxError as error:
        raise _malformed(error) from error
    except Exception as error:
        raise UserError(f"SPARQL query: {one_line(error)}. Example: {EXAMPLE}") from error


def _answer(output: IO[bytes], graph: KnowledgeGraph) -> Answer:
    """Read an answer; blank nodes that the query made are numbered in its order."""
    known = set(graph.entities)
    made: dict[str, str] = defaultdict(blank_names(known).__next__)

    def name(term: Any) -> str:
        text = "" if term is None else name_of_term(term)
        return made[text] if text.startswith("_:") and text not in known else text

    def bounded(found: Iterable[Any]) -> Iterator[Any]:
        for number, each in enumerate(found):
            if number == MAX_ROWS:
                raise UserError(f"SPARQL query: more than {MAX_ROWS:,} rows. Add a LIMIT.")
            yield each

    is_graph = output.read(1) != b"{"
    output.seek(0)
    if is_graph:
        builder = GraphBuilder()
        for quad in bounded(parse(output, RdfFormat.N_TRIPLES)):
            builder.add_statement(*map(name, quad.triple))
        return Answer((), (), builder.build())
    result = parse_query_results(output, QueryResultsFormat.JSON)
    if isinstance(result, QueryBoolean):
        return Answer(("answer",), (("yes" if result else "no",),))
    columns = tuple(variable.value for variable in result.variables)
    return Answer(columns, tuple(sorted(tuple(map(name, row)) for row in bounded(result))))


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
