"""SPARQL queries on a knowledge graph, evaluated by pyoxigraph."""

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import product
from typing import Any, NamedTuple

from pyoxigraph import Quad, QueryBoolean, QueryTriples, Store, Triple

from knowarm.errors import UserError
from knowarm.knowledge.formats.rdf import PREFIXES, rdf_triples
from knowarm.knowledge.graph.builder import GraphBuilder
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.terms import blank_names, name_of_term, triple_of_names
from knowarm.reading import one_line

EXAMPLE = "SELECT ?colour WHERE { :mug :hasColor ?colour }"
_QUIET = re.compile(
    r"""<[^<>"{}|^`\\\s]*>|"{3}(?:[^\\]|\\.)*?"{3}|'{3}(?:[^\\]|\\.)*?'{3}|"""
    r""""(?:[^"\\\n]|\\.)*"|'(?:[^'\\\n]|\\.)*'|\\.|(\#[^\n]*)""",
    re.DOTALL,
)
"""IRIs, strings, escaped characters and, as a group, comments."""
_REMOTE = re.compile(
    r"([:?$@]?)[\w%-]*?(service(?=\s*(?:silent\s*)?[^\s{}]*\s*\{)|\bfrom\b(?!:))",
    re.IGNORECASE,
)
"""Keywords that refer to other data; after the first group it is the name of a thing."""


class Answer(NamedTuple):
    """Result of a query."""

    # Names of the variables; ("answer",) for ASK; empty for CONSTRUCT and DESCRIBE
    columns: tuple[str, ...]
    # Names of entities and relations, sorted; "" where a variable is unbound
    rows: tuple[tuple[str, ...], ...]
    graph: KnowledgeGraph | None = None  # The graph of CONSTRUCT and DESCRIBE


class SparqlQuery:
    """A query of a graph; `:` is the prefix of plain names, as in `:mug :hasColor ?colour`.

    Raises:
        UserError: the query refers to other data than the graph.
    """

    def __init__(self, graph: KnowledgeGraph, query: str) -> None:
        text = _QUIET.sub(lambda quiet: " " if quiet[1] else "_", query)
        for match in _REMOTE.finditer(text):
            if not match[1]:
                raise UserError(
                    f"SPARQL query: {match[2].upper()} refers to other data, but a query reads the "
                    f"given graph only and nothing is fetched from the network. Leave it out, or "
                    f"load the other graph and unite the two first."
                )
        self.query = query
        self._entities = set(graph.entities)
        self._store = Store()
        self._store.bulk_extend(map(_quad, rdf_triples(graph)))

    def answer(self) -> Answer:
        """Run the query; blank nodes that it made are numbered in the order of the answer.

        Raises:
            UserError: the query is malformed.
        """
        made: dict[str, str] = defaultdict(blank_names(self._entities).__next__)

        def name(term: Any) -> str:
            text = "" if term is None else name_of_term(term)
            if text.startswith("_:") and text not in self._entities:
                return made[text]
            return text

        try:
            result: Any = self._store.query(self.query, prefixes=PREFIXES)
            if isinstance(result, QueryTriples):
                builder = GraphBuilder()
                for triple in result:
                    builder.add_statement(*map(name, triple))
                return Answer((), (), builder.build())
            if isinstance(result, QueryBoolean):
                return Answer(("answer",), (("yes" if result else "no",),))
            columns = tuple(variable.value for variable in result.variables)
            rows = sorted(tuple(map(name, row)) for row in result)
            return Answer(columns, tuple(rows))
        except UserError:
            raise
        except SyntaxError as error:
            raise _malformed(error) from error
        except Exception as error:
            raise UserError(
                f"SPARQL query: {one_line(error)}. Example: {EXAMPLE}"
            ) from error

    @contextmanager
    def stating(
        self, head: str, relations: Iterable[str], tails: Iterable[str]
    ) -> Iterator[None]:
        """State, in a ``with`` block, that relations lead from a head to these tails alone."""
        new = list[Quad]()
        old = set[Quad]()
        for relation, tail in product(relations, tails):
            quad = _quad(triple_of_names(head, relation, tail))
            new.append(quad)
            old.update(
                self._store.quads_for_pattern(quad.subject, quad.predicate, None)
            )
        self._replace(old, new)
        yield
        self._replace(new, old)

    def _replace(self, old: Iterable[Quad], new: Iterable[Quad]) -> None:
        for quad in old:
            self._store.remove(quad)
        self._store.extend(new)


def sparql(graph: KnowledgeGraph, query: str) -> Answer:
    """Run a query on a graph; see `SparqlQuery`."""
    return SparqlQuery(graph, query).answer()


def _quad(triple: Triple) -> Quad:
    return Quad(triple.subject, triple.predicate, triple.object)


def _malformed(error: SyntaxError) -> UserError:
    match = re.match(r"error at (\d+):(\d+): (.*)", str(error.msg), re.DOTALL)
    if match is None:
        return UserError(f"SPARQL query: {error.msg}. Example: {EXAMPLE}")
    line, column, reason = match.groups()
    short = reason if len(reason) <= 60 else "unexpected symbol or end of the query"
    return UserError(
        f"SPARQL query, line {line}, column {column}: {short}. Check that every prefix is "
        f"declared with PREFIX. Example: {EXAMPLE}"
    )
