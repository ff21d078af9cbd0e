"""SPARQL queries on a knowledge graph, evaluated by pyoxigraph in memory."""

import re
import threading
from dataclasses import dataclass
from itertools import islice

from pyoxigraph import Quad, QueryBoolean, QueryTriples, Store

from knowarm.errors import UserError
from knowarm.knowledge.builder import GraphBuilder
from knowarm.knowledge.formats.rdf import PREFIXES, rdf_triples
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.terms import name_of_term
from knowarm.reading import one_line

EXAMPLE = "SELECT ?colour WHERE { :mug :hasColor ?colour }"

TIMEOUT_S = 20.0
"""Longest time that a query may take [s]."""

MAX_ROWS = 1_000_000
"""Most rows of an answer."""

MAX_QUERY, STACK = 20_000, 256 * 2**20
"""Most characters of a query, and the bytes of stack that the engine has for it: it calls itself
for every pair of brackets, and a stack that is too small for them ends the process."""

_IRI = re.compile(r'<[^<>"{}|^`\\\s]*>')

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


def sparql(graph: KnowledgeGraph, query: str, *, timeout_s: float = TIMEOUT_S) -> Answer:
    """Run a query; the prefix `:` stands for plain names, as in `:mug :hasColor ?colour`.

    Args:
        graph: the graph, with its labels as rdfs:label.
        query: SELECT, ASK, CONSTRUCT or DESCRIBE. The common prefixes (rdf, rdfs, owl, skos,
            xsd) are declared.
        timeout_s: longest time to wait for the answer [s]; the query goes on in the background.

    Raises:
        UserError: the query is malformed or too long, takes too long, has too many rows, or refers
            to other data with SERVICE or FROM.
    """
    if len(query) > MAX_QUERY:
        raise UserError(
            f"SPARQL query: it has {len(query):,} characters, and at most {MAX_QUERY:,} are read. "
            f"Ask for less at once."
        )
    _refuse_other_data(query)
    store = Store()
    store.bulk_extend(Quad(*triple) for triple in rdf_triples(graph))
    answers: list[Answer | BaseException] = []

    def run() -> None:
        try:
            answers.append(_answer(store, query))
        except BaseException as error:  # the thread that waits raises it
            # The engine's objects in its frames must be dropped by this thread.
            answers.append(error.with_traceback(None))

    # The query engine can neither be interrupted nor limited; it does release the interpreter.
    thread = threading.Thread(target=run, name="SPARQL query", daemon=True)
    before = threading.stack_size(STACK)
    try:
        thread.start()
    finally:
        threading.stack_size(before)
    thread.join(timeout_s)
    if not answers:
        raise UserError(
            f"SPARQL query: no answer after {timeout_s:g} s. Connect the patterns by common "
            f"variables, add a LIMIT, or pass a longer timeout_s."
        )
    if isinstance(answers[0], Answer):
        return answers[0]
    if isinstance(answers[0], SyntaxError):
        raise _malformed(answers[0]) from answers[0]
    if isinstance(answers[0], UserError):
        raise answers[0]
    raise UserError(f"SPARQL query: {one_line(answers[0])}. Example: {EXAMPLE}") from answers[0]


def _answer(store: Store, query: str) -> Answer:
    result = store.query(query, prefixes=PREFIXES)
    if isinstance(result, QueryBoolean):
        return Answer(("answer",), (("yes" if result else "no",),))
    if isinstance(result, QueryTriples):
        builder = GraphBuilder()
        for triple in islice(result, MAX_ROWS):
            builder.add_statement(*map(name_of_term, triple))
        return Answer((), (), builder.build())
    columns = tuple(variable.value for variable in result.variables)
    rows = [
        tuple("" if t is None else name_of_term(t) for t in row)
        for row in islice(result, MAX_ROWS + 1)
    ]
    if len(rows) > MAX_ROWS:
        raise UserError(f"SPARQL query: more than {MAX_ROWS:,} rows. Add a LIMIT.")
    return Answer(columns, tuple(sorted(rows)))


def _refuse_other_data(query: str) -> None:
    """Refuse queries that would read other data than the graph, over the network or not.

    SERVICE is refused even inside strings and comments: telling what a string is would repeat the
    grammar of SPARQL, and a mistake there would open the network.
    """
    found = re.search(r"\bfrom\b", _NO_KEYWORDS.sub(" ", query), re.IGNORECASE)
    for service in re.finditer("service", _IRI.sub(" ", query), re.IGNORECASE):
        before = re.search(r"[:?$@]?[\w%-]*$", service.string[: service.start()])
        if before is not None and before[0][:1] not in tuple(":?$@"):
            found = service
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
