"""Questions: facts, chains, counts, "and", "or", "not" and SPARQL, answered with their evidence.

    usedFor drinking and not hasColor blue
    hasPart spout or (isMadeOf wood and isLocatedIn garden)
    usedFor (relatedTo tea)                    a use that is related to tea
    count hasPart >= 3                         objects with three parts or more
    count contains (isA beverage) = 1
    SELECT ?object WHERE { ?object :usedFor :drinking }

"not" binds tighter than "and", and that tighter than "or". A value reaches to the next keyword or
bracket; in double quotes it may hold any of them.
"""

import operator
import re
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from knowarm.errors import UserError, unknown_name
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.terms import local_name
from knowarm.knowledge.queries.sparql import SparqlQuery
from knowarm.questions import COLOUR_RELATION, ObjectColour

Evidence = tuple[str, ...]
"""Why something answers: triples of the graph, what the image shows, and what is not stated."""

Part = Callable[[int, str | None], Evidence | None]
"""Part of a question: why it is true of an entity in the colour that is shown, or None."""

SIGNS: dict[str, Callable[[int, int], bool]] = {
    ">=": operator.ge,
    "<=": operator.le,
    ">": operator.gt,
    "<": operator.lt,
    "=": operator.eq,
}
"""Comparisons of a count."""

MOST_NESTED, MOST_WORDS = 50, 500
"""Most brackets and negations of a question, and most words."""

_TOKEN = re.compile(r'"[^"]*"|[()]|[<>]=?|=|[^\s()<>="]+|"')
_KEYWORDS = {"and", "or", "not", "count", "(", ")", *SIGNS}
_SPARQL = re.compile(r"\s*(PREFIX|BASE|SELECT|ASK|CONSTRUCT|DESCRIBE)\b", re.IGNORECASE)


class Answers(NamedTuple):
    """The answers to a question among F facets."""

    question: str
    satisfies: np.ndarray  # Whether each facet answers, (F,) bool
    evidence: dict[ObjectColour, Evidence]  # Why, by answering facet


def answer(graph: KnowledgeGraph, facets: Sequence[ObjectColour], text: str) -> Answers:
    """Answer a question by a graph; objects that it does not describe never answer.

    Raises:
        UserError: the question is malformed, names what the graph does not hold, or has no answer.
    """
    entities = {name: graph.find_entity(name) for name in dict.fromkeys(name for name, _ in facets)}
    if not any(entity is not None for entity in entities.values()):
        raise UserError(
            f"The graph describes none of the {len(entities)} objects of the task, such as "
            f"{next(iter(entities))!r}. Name objects as `knowarm list` does, or give another graph."
        )
    colours = {colour for _, colour in facets}
    part = _sparql(graph, text) if _SPARQL.match(text) else _Reader(text, graph, colours).whole()
    evidence = {}
    for name, colour in facets:
        entity = entities[name]
        why = None if entity is None else part(entity, colour)
        if why is not None:
            evidence[name, colour] = why
    if not evidence:
        raise UserError(
            f"No object of the task answers the question {text!r}. Ask another one, or add the "
            "missing triple to the graph."
        )
    return Answers(text, np.array([facet in evidence for facet in facets]), evidence)


class _Relation(NamedTuple):
    """A relation of a question: its name, and its ids in the graph."""

    name: str
    ids: frozenset[int]


class _Reader:
    """Reads a question word by word, by recursive descent."""

    def __init__(self, text: str, graph: KnowledgeGraph, colours: set[str]) -> None:
        self.text, self.graph, self.colours = text, graph, colours
        self.words, self.place = [*_TOKEN.findall(text), ""], 0
        deep, count = self.words.count("(") + self.words.count("not"), len(self.words) - 1
        if deep > MOST_NESTED or count > MOST_WORDS:
            raise UserError(
                f"The question has {count} words and {deep} brackets and negations; at most "
                f"{MOST_WORDS} and {MOST_NESTED} are read. Ask a shorter one."
            )

    def whole(self) -> Part:
        """Read to the end."""
        part = self.joined("or")
        if self.next:
            raise self.wrong("'and' or 'or'")
        return part

    @property
    def next(self) -> str:
        """The next word, which is not taken; empty at the end."""
        return self.words[self.place]

    def take(self, *words: str) -> str:
        """Take the next word if it is one of some, or, without any, if it is a name."""
        fits = self.next in words if words else self.next and self.next not in _KEYWORDS
        word = self.next if fits else ""
        self.place += bool(word)
        return word

    def wrong(self, expected: str) -> UserError:
        """Return the error for a word that does not fit."""
        got = repr(self.next) if self.next else "its end"
        return UserError(
            f"The question {self.text!r}: expected {expected}, got {got}. Example: usedFor "
            "drinking and not hasColor blue"
        )

    def joined(self, word: str) -> Part:
        """Read parts joined by "or", or by "and"."""
        parts = list[Part]()
        while not parts or self.take(word):
            parts.append(self.joined("and") if word == "or" else self.one())

        def evidence(entity: int, colour: str | None) -> Evidence | None:
            whys = [part(entity, colour) for part in parts]
            reasons = [why for why in whys if why is not None]
            if word == "or":
                return reasons[0] if reasons else None
            return sum(reasons, ()) if len(reasons) == len(parts) else None

        return parts[0] if len(parts) == 1 else evidence

    def one(self) -> Part:
        """Read a negation, a bracket, a count, a chain or a fact."""
        if self.take("not"):
            begin, part = self.place, self.one()
            missing = f"not stated: {' '.join(self.words[begin : self.place])}"
            return lambda entity, colour: (missing,) if part(entity, colour) is None else None
        if self.next == "(":
            return self.bracket()
        counts = self.take("count")
        relation = self.relation()
        of: Part = self.bracket() if self.next == "(" else lambda entity, colour: ()
        if counts:
            return self.count(relation, of)
        return (
            self.chain(relation, of) if self.words[self.place - 1] == ")" else self.fact(relation)
        )

    def fact(self, relation: _Relation) -> Part:
        """Read a value; the colour of what is shown is seen, not looked up."""
        names = list[str]()
        while word := self.take():
            names.append(word.strip('"'))
        if not (value := " ".join(names)):
            raise self.wrong(f"a value of {relation.name}")
        is_colour = relation.name == COLOUR_RELATION
        ids = self.graph.values(value)
        if not ids and not (is_colour and value in self.colours):
            known = {local_name(self.graph.names[i]) for i in self.graph.tails_of(relation.ids)}
            raise unknown_name(f"value of {relation.name}", value, known)

        def evidence(entity: int, colour: str | None) -> Evidence | None:
            if is_colour and colour is not None:
                return (f"the image shows {value}",) if colour == value else None
            links = self.links(entity, relation)
            return next(((text,) for text, tail in links if tail in ids), None)

        return evidence

    def chain(self, relation: _Relation, of: Part) -> Part:
        """Return the part that is true where a relation leads to something of which one is."""

        def evidence(entity: int, colour: str | None) -> Evidence | None:
            links = self.links(entity, relation)
            whys = ((text, of(tail, colour if tail == entity else None)) for text, tail in links)
            return next(((text, *why) for text, why in whys if why is not None), None)

        return evidence

    def count(self, relation: _Relation, of: Part) -> Part:
        """Read a comparison with the number of values of a relation."""
        sign = self.take(*SIGNS)
        number = self.take() if sign else ""
        if not number.isdecimal() or len(number) > 9:
            raise self.wrong("a comparison such as >= 2")

        def evidence(entity: int, colour: str | None) -> Evidence | None:
            links = self.links(entity, relation)
            whys = [(text, of(tail, colour if tail == entity else None)) for text, tail in links]
            reasons = [(text, *why) for text, why in whys if why is not None]
            fits = SIGNS[sign](len(reasons), int(number))
            return (*sum(reasons, ()), f"counted: {len(reasons)}") if fits else None

        return evidence

    def bracket(self) -> Part:
        """Read a part in brackets."""
        self.take("(")
        part = self.joined("or")
        if not self.take(")"):
            raise self.wrong("')'")
        return part

    def relation(self) -> _Relation:
        """Read one word: the name of a relation, its last part or its label."""
        if not (word := self.take().strip('"')):
            raise self.wrong("a relation")
        if local_name(word) == COLOUR_RELATION:  # the image answers it, whoever else states it
            names = self.graph.relation_names
            return _Relation(COLOUR_RELATION, frozenset(names.find_local(COLOUR_RELATION)))
        return _Relation(local_name(word), frozenset([self.graph.relation_id(word)]))

    def links(self, entity: int, relation: _Relation) -> Iterator[tuple[str, int]]:
        """Yield the triples of a relation whose head is an entity, as text, and their tails."""
        graph = self.graph
        for row in graph.out_rows(entity):
            if int(graph.relations[row]) in relation.ids:
                tail = int(graph.tails[row])
                texts = (
                    local_name(graph.names[entity]),
                    relation.name,
                    local_name(graph.names[tail]),
                )
                yield " ".join(texts), tail


def _sparql(graph: KnowledgeGraph, text: str) -> Part:
    """Return what a SPARQL query selects as ?object and, if it does, in the colour ?colour.

    It runs once per facet, whose colour the graph then states, as the image shows it.
    """
    query, names = SparqlQuery(graph, text), graph.relation_names
    relations = {COLOUR_RELATION, *(names[i] for i in names.find_local(COLOUR_RELATION))}

    def evidence(entity: int, colour: str | None) -> Evidence | None:
        tail = None if colour is None else graph.find_entity(colour)
        shown = colour if tail is None else graph.names[tail]
        with query.stating(graph.names[entity], relations, [] if shown is None else [shown]):
            result = query.answer()
        other = set(result.columns) - {"object", "colour", "color"}
        if "object" not in result.columns or other:
            raise UserError(
                "A question in SPARQL must select ?object, and may select ?colour, and no more; "
                f"got {', '.join(result.columns) or 'no variables'}. Example: SELECT ?object "
                "WHERE { ?object :usedFor :drinking }"
            )
        for row in result.rows:
            named = dict(zip(result.columns, row, strict=True))
            colours = {local_name(n) for key, n in named.items() if key != "object" and n}
            if graph.find_entity(named["object"]) == entity and colours <= {colour}:
                return tuple(f"?{name} = {local_name(value)}" for name, value in named.items())
        return None

    return evidence
