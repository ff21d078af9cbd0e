"""Questions in words: facts, chains, counts, comparisons, "and", "or" and "not".

    usedFor drinking and not hasColor blue
    hasPart spout or (isMadeOf wood and isLocatedIn garden)
    usedFor (relatedTo tea)                    a use that is related to tea
    count hasPart >= 3                         objects with three parts or more
    count contains (isA beverage) = 1
    price < 6 and made >= 2020-01-01           numbers and dates

"not" binds tighter than "and", and that tighter than "or". A value reaches to the next keyword or
bracket; in double quotes it may hold any of them.
"""

import operator
import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any, NamedTuple

import numpy as np

from knowarm.errors import UserError, unknown_name
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.terms import local_name, name_key
from knowarm.questions import COLOUR_RELATION

Evidence = tuple[str, ...]
"""Why something answers: triples of the graph, what the image shows, and what is not stated."""

Part = Callable[[int, str | None], Evidence | None]
"""Part of a question: why it is true of an entity in the colour that is shown, or None."""

SIGNS: dict[str, Callable[[Any, Any], bool]] = {
    ">=": operator.ge,
    "<=": operator.le,
    ">": operator.gt,
    "<": operator.lt,
    "=": operator.eq,
    "==": operator.eq,
    "!=": operator.ne,
}
"""Comparisons of counts, numbers and dates."""

MOST_NESTED, MOST_WORDS = 50, 500
"""Most brackets and negations of a question, and most words."""

_TOKEN = re.compile(r'"[^"]*"|[()]|[<>=!]=|[<>=]|[^\s()<>=!"]+|["!]')
_KEYWORDS = {"and", "or", "not", "count", "(", ")", *SIGNS}
_COLOUR = [name_key(COLOUR_RELATION), name_key("hasColour")]


def _quantity(text: str) -> tuple[str, float] | None:
    """Return the kind and value of a number or an ISO date."""
    with suppress(ValueError):
        return "number", float(text)
    with suppress(ValueError):
        return "date", datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp()
    return None


class _Relation(NamedTuple):
    """A relation of a question: its name, and its ids in the graph."""

    name: str
    ids: frozenset[int]


class QuestionReader:
    """Reads a question word by word, by recursive descent."""

    def __init__(self, text: str, graph: KnowledgeGraph, colours: set[str]) -> None:
        self.text, self.graph, self.colours = text, graph, colours
        self.words, self.place = [*_TOKEN.findall(text), ""], 0
        self.has_relation = False  # Whether a relation was read: no sentence begins with one
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
        if self.next in SIGNS and not counts:
            return self.comparison(relation)
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
        if is_colour:
            value = {name_key(colour): colour for colour in self.colours}.get(
                name_key(value), value
            )
        quantity = _quantity(value)
        equal = (i for i in self.tails(relation) if quantity and self.quantity(i) == quantity)
        ids = {*self.graph.values(value), *equal}
        if not ids and not (is_colour and value in self.colours):
            known = {local_name(self.graph.names[i]) for i in self.tails(relation)}
            known |= self.colours if is_colour else set()
            raise unknown_name(f"value of {relation.name}", value, known)

        def evidence(entity: int, colour: str | None) -> Evidence | None:
            if is_colour and colour is not None:
                return (f"the image shows {value}",) if colour == value else None
            return stated(entity, colour)

        stated = self.chain(relation, lambda tail, colour: () if tail in ids else None)
        return evidence

    def chain(self, relation: _Relation, of: Part) -> Part:
        """Return the part that is true where a relation leads to something of which one is."""

        def evidence(entity: int, colour: str | None) -> Evidence | None:
            links = self.links(entity, relation)
            whys = ((text, of(tail, colour if tail == entity else None)) for text, tail in links)
            return next(((text, *why) for text, why in whys if why is not None), None)

        return evidence

    def comparison(self, relation: _Relation) -> Part:
        """Read a comparison with a number or a date."""
        sign, text = self.take(*SIGNS), self.take()
        wanted = _quantity(text)
        if wanted is None:
            raise self.wrong("a number or a date")
        known = {i: quantity for i in self.tails(relation) if (quantity := self.quantity(i))}
        if not any(kind == wanted[0] for kind, _ in known.values()):
            raise UserError(
                f"The question {self.text!r}: the graph states no {wanted[0]} by {relation.name}."
            )

        def fits(tail: int, colour: str | None) -> Evidence | None:
            kind, value = known.get(tail, ("", 0))
            return () if kind == wanted[0] and SIGNS[sign](value, wanted[1]) else None

        return self.chain(relation, fits)

    def tails(self, relation: _Relation) -> list[int]:
        """Return the ids of what a relation leads to."""
        graph = self.graph
        return np.unique(graph.tails[np.isin(graph.relations, list(relation.ids))]).tolist()

    def quantity(self, entity: int) -> tuple[str, float] | None:
        """Return the number or date that a name or literal is."""
        return _quantity(local_name(self.graph.names[entity]))

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
        if name_key(local_name(word)) in _COLOUR:  # the image answers it, whoever else states it
            names, self.has_relation = self.graph.relation_names, True
            return _Relation(COLOUR_RELATION, frozenset(names.find_local(COLOUR_RELATION)))
        relation = self.graph.relation_id(word)
        self.has_relation = True
        return _Relation(local_name(self.graph.relation_names[relation]), frozenset([relation]))

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
