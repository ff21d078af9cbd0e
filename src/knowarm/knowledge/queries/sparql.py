"""SPARQL queries on a knowledge graph, evaluated by pyoxigraph."""

import re
from collections import defaultdict
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, TypeVar
from urllib.parse import urljoin

from pyoxigraph import QueryBoolean, QueryTriples

from knowarm.errors import UserError
from knowarm.fence import fenced
from knowarm.knowledge.formats.rdf import PREFIXES
from knowarm.knowledge.graph.builder import GraphBuilder
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.terms import (
    LABEL_RELATIONS,
    blank_names,
    iri_of_name,
    local_name,
    name_of_iri,
    name_of_term,
    object_term,
)
from knowarm.knowledge.queries.store import LOCK, store_of
from knowarm.reading import one_line

T = TypeVar("T")
EXAMPLE = "SELECT ?colour WHERE { :mug :hasColor ?colour }"
_QUIET = (
    r'"{3}(?:[^\\]|\\.)*?"{3}|' + r"'{3}(?:[^\\]|\\.)*?'{3}|"
    r""""(?:[^"\\\n]|\\.)*"|'(?:[^'\\\n]|\\.)*'|\\.|(?P<comment>\#[^\r\n]*)"""
)
"""Strings, escaped characters and comments."""
_IRI = r"""<(?:[^<>"{}|^`\\\0-\x20]|\\[uU])*>"""
_QUIET_OR_IRI = re.compile(f"(?P<iri>{_IRI})|{_QUIET}", re.DOTALL)
_REMOTE = re.compile(
    r"[:?$@][\w%-]*+|(?<![\w%-])[\w%-]*?"
    r"(service(?=\s*+(?:silent\s*+)?+[^\0-\x20{}]*+\s*+\{)|\bfrom\b(?!:))",
    re.IGNORECASE,
)
"""Names of things, and keywords that refer to other data, in the first group."""
_PREFIX = r"(?:[^\W\d_][\w.-]*)?"
_LOCAL = r"(?:[\w:%-]|\\.|\.(?=[\w:%.\\-]))*"
_NAMES = re.compile(
    rf"""\bprefix\s+(?P<declared>{_PREFIX}):\s*<(?P<iri>[^<>]*)>|\bbase\s+<(?P<base>[^<>]*)>|
    [^\W\d_][\w.-]*+(?!:)|
    [?$@][\w-]+|_:[\w.-]+|\^\^\s*(?:{_IRI}|{_PREFIX}:{_LOCAL})|{_QUIET}|
    (?><(?P<full>[^<>"{{}}|^`\\\s]*)>|(?P<prefix>{_PREFIX}):(?P<local>{_LOCAL}))(?!\s*\()""",
    re.DOTALL | re.IGNORECASE | re.VERBOSE,
)
"""Declarations, words, and names that are neither datatypes nor functions."""
_ANY_RELATION = re.compile(
    r"""[^\s{}.]\s*[?$]\w++\s*(?=[?$_"'\[(<:\d+-]|\.\d|[^\W\d][\w.-]*:|true\b|false\b)|
    !(?!=)|\*|[\w>)]\?""",
    re.IGNORECASE | re.VERBOSE,
)
"""Variables between two terms, which may stand for relations, and paths of any relation."""
_ESCAPE = re.compile(r"\\(.)")


class Answer(NamedTuple):
    """Result of a query."""

    # Names of the variables; ("answer",) for ASK; empty for CONSTRUCT and DESCRIBE
    columns: tuple[str, ...]
    # Names of entities and relations, sorted; "" where a variable is unbound
    rows: tuple[tuple[str, ...], ...]
    graph: KnowledgeGraph | None = None  # The graph of CONSTRUCT and DESCRIBE

    @property
    def is_nothing(self) -> bool:
        """Whether it is "no", or has no rows and no triples."""
        return self.rows in ((), (("no",),)) and not self.graph


class SparqlQuery:
    """A query of a graph.

    Prefixes are those of the query, else those of the graph's file, else `PREFIXES`, whose `:` is
    that of plain names, as in `:mug :hasColor ?colour`.

    Raises:
        UserError: the query refers to other data than the graph.
    """

    def __init__(self, graph: KnowledgeGraph, query: str) -> None:
        for match in _REMOTE.finditer(_keywords(query, "_")):
            if match[1]:
                raise UserError(
                    f"SPARQL query: {match[1].upper()} refers to other data, but a query reads the "
                    f"given graph only and nothing is fetched from the network. Leave it out, or "
                    f"load the other graph and unite the two first."
                )
        self.query = query
        self.graph = graph
        self.prefixes = {**PREFIXES, **graph.prefixes}
        self.store = store_of(graph)

    def answer(self, about: str | None = None) -> Answer:
        """Run the query in a process with limits; see `run`.

        Raises:
            UserError: the query is malformed, or needs more time or memory than the limits.
        """
        return limited(self.run, about)

    def run(self, about: str | None = None) -> Answer:
        """Run the query; blank nodes that it made are numbered in the order of the answer.

        Args:
            about: a name without which rows are left out; None keeps all.

        Raises:
            UserError: the query is malformed.
        """
        taken = self.graph.names
        made: dict[str, str] = defaultdict(blank_names(taken).__next__)

        def name(term: Any) -> str:
            text = "" if term is None else name_of_term(term)
            if text.startswith("_:") and text not in taken:
                return made[text]
            return text

        try:
            with LOCK:
                return self._run(name, about)
        except SyntaxError as error:
            raise self._malformed(error) from error

    @property
    def hint(self) -> str:
        """Which IRIs of the query the graph does not hold, with the nearest that it holds."""
        unknown = []
        for iri in dict.fromkeys(self._names()[0]):
            name = name_of_iri(iri)
            if self._holds(name):
                continue
            near = self._alike(local_name(name))
            unknown.append(f"<{iri}>" + (f" (but <{near}>)" if near else ""))
        if not unknown:
            return ""
        return f"The graph does not hold {', '.join(unknown[:5])}."

    def may_read(self, local: str) -> bool:
        """Return whether triples of relations with this last part may change the answer.

        In doubt they may: where a variable or a path can stand for any relation.
        """
        iris, _ = self._names()
        if any(local in text for text in (self.query, *iris)):
            return True
        if "\\" in self.query or "%" in self.query:  # other spellings of the name
            return True
        return _ANY_RELATION.search(_keywords(self.query, " _ ")) is not None

    def _run(self, name: Callable[[Any], str], about: str | None) -> Answer:
        """Run the query; ``name`` gives the terms their names."""
        result: Any = self.store.query(self.query, prefixes=self.prefixes)
        if isinstance(result, QueryTriples):
            builder = GraphBuilder()
            for triple in result:
                builder.add_statement(*map(name, triple))
            return Answer((), (), builder.build())
        if isinstance(result, QueryBoolean):
            return Answer(("answer",), (("yes" if result else "no",),))
        columns = tuple(variable.value for variable in result.variables)
        terms: Iterable[tuple[Any, ...]] = map(tuple, result)
        if about is not None:
            wanted = object_term(about)
            terms = [row for row in terms if wanted in row]
        rows = sorted(tuple(map(name, row)) for row in terms)
        return Answer(columns, tuple(rows))

    def _names(self) -> tuple[list[str], list[str]]:
        """Return the IRIs that the query names, and the prefixes that nothing declares."""
        declared = dict(self.prefixes)
        base = ""
        iris = []
        undeclared = []
        for token in _NAMES.finditer(self.query):
            prefix = token["prefix"]
            if token["declared"] is not None:
                declared[token["declared"]] = urljoin(base, token["iri"])
            elif token["base"] is not None:
                base = urljoin(base, token["base"])
            elif token["full"] is not None:
                iris.append(urljoin(base, token["full"]))
            elif prefix in declared:
                iris.append(declared[prefix] + _ESCAPE.sub(r"\1", token["local"]))
            elif prefix is not None:
                undeclared.append(prefix)
        return iris, undeclared

    def _holds(self, name: str) -> bool:
        """Return whether a name occurs in the graph."""
        graph = self.graph
        known = (graph.names, graph.relation_names, LABEL_RELATIONS)
        return any(name in names for names in known)

    def _alike(self, local: str) -> str | None:
        """Return the IRI of the graph's only entity or relation with this last part."""
        graph = self.graph
        alike = set(graph.names.at(graph.names.find_local(local)))
        alike.update(graph.relation_names.at(graph.relation_names.find_local(local)))
        return iri_of_name(alike.pop()) if len(alike) == 1 else None

    def _malformed(self, error: SyntaxError) -> UserError:
        """Return the error for a query that the parser refuses."""
        _, undeclared = self._names()
        if undeclared and "Prefix not found" in str(error.msg):
            known = ":, ".join(self.prefixes)
            return UserError(
                f"SPARQL query: nothing declares the prefix {undeclared[0]}: Known: {known}:. "
                f"Take one of these, or begin with PREFIX {undeclared[0]}: and its IRI in <>."
            )
        match = re.match(r"error at (\d+):(\d+): (.*)", str(error.msg), re.DOTALL)
        if match is None:
            return UserError(f"SPARQL query: {error.msg}. Example: {EXAMPLE}")
        line, column, reason = match.groups()
        short = reason if len(reason) <= 60 else "unexpected symbol or end of the query"
        return UserError(
            f"SPARQL query, line {line}, column {column}: {short}. Check that every prefix is "
            f"declared with PREFIX. Example: {EXAMPLE}"
        )


def _keywords(query: str, mark: str) -> str:
    """Return a query with a mark for strings, ``<>`` for IRIs, and without comments."""
    marks = {"comment": " ", "iri": " <> ", None: mark}
    return _QUIET_OR_IRI.sub(lambda token: marks[token.lastgroup], query)


def limited(function: Callable[..., T], *arguments: Any) -> T:
    """Call a function that runs queries in a process with limits, which opens no connection."""
    try:
        return fenced(function, *arguments, opens=False)
    except UserError:
        raise
    except ValueError as error:
        reason = one_line(error)
        raise UserError(f"SPARQL query: {reason}. Example: {EXAMPLE}") from error


def sparql(graph: KnowledgeGraph, query: str) -> Answer:
    """Run a query on a graph; see `SparqlQuery`."""
    return SparqlQuery(graph, query).answer()
