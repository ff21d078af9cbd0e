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
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from datetime import UTC, datetime
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from knowarm.errors import UserError, unknown_name
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.terms import local_name, name_key
from knowarm.questions import COLOUR_RELATION

Evidence = tuple[str, ...]
"""Why something answers: triples of the graph, what the image shows, and what is not stated."""

Colour = str | None
"""The colour in which an entity is shown, None of one that is not shown."""

Reason = Evidence | None
"""Why a part of a question is true, None if it is not."""

Part = Callable[[int, Colour], Reason]
"""Part of a question: why it is true of an entity in the colour that is shown."""

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

MOST_NESTED = 50
MOST_WORDS = 500
"""Most brackets and negations of a question, and most words."""

_TOKEN = re.compile(r'"[^"]*"|[()]|[<>=!]=|[<>=]|[^\s()<>=!"]+|["!]')
_NO_NAMES = {"", "and", "or", "not", "count", "(", ")", *SIGNS}
_COLOUR = [name_key(COLOUR_RELATION), name_key("hasColour")]

_Quantity = tuple[str, float]
"""The kind of a number or date, and its value."""


def _quantity(text: str) -> _Quantity | None:
    """Return the kind and value of a number or an ISO date."""
    with suppress(ValueError):
        return "number", float(text)
    with suppress(ValueError):
        return "date", datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp()
    return None


def _anything(entity: int, colour: Colour) -> Reason:
    """Return no reason, as of a value that counts whatever it is."""
    return ()


class _Relation(NamedTuple):
    """A relation of a question: its name, and its ids in the graph."""

    name: str
    ids: list[int]


class QuestionReader:
    """Reads a question word by word, by recursive descent.

    Attributes:
        taken: number of words that were read.
        has_relation: whether a relation was read; no sentence begins with one.
    """

    def __init__(
        self, text: str, graph: KnowledgeGraph, colours: Collection[str]
    ) -> None:
        self.text = text
        self.graph = graph
        self.colours = colours
        self.words = [*_TOKEN.findall(text), ""]
        self.taken = 0
        self.has_relation = False
        deep = self.words.count("(") + self.words.count("not")
        count = len(self.words) - 1
        if deep > MOST_NESTED or count > MOST_WORDS:
            raise UserError(
                f"The question has {count} words and {deep} brackets and negations; at most "
                f"{MOST_WORDS} and {MOST_NESTED} are read. Ask a shorter one."
            )

    def whole(self) -> Part:
        """Read to the end."""
        part = self.either()
        if self.next:
            raise self.wrong("'and' or 'or'")
        return part

    @property
    def next(self) -> str:
        """The next word, which is not taken; empty at the end."""
        return self.words[self.taken]

    def take(self, *words: str) -> str:
        """Take the next word if it is one of some, or return ""."""
        word = self.next
        if word not in words:
            return ""
        self.taken += 1
        return word

    def take_name(self) -> str:
        """Take the next word if it is a name, or return ""."""
        if self.next in _NO_NAMES:
            return ""
        return self.take(self.next)

    def wrong(self, expected: str) -> UserError:
        """Return the error for a word that does not fit."""
        got = repr(self.next) if self.next else "its end"
        return UserError(
            f"The question {self.text!r}: expected {expected}, got {got}. Example: usedFor "
            "drinking and not hasColor blue"
        )

    def either(self) -> Part:
        """Read parts joined by "or"."""
        parts = [self.both()]
        while self.take("or"):
            parts.append(self.both())

        def evidence(entity: int, colour: Colour) -> Reason:
            for part in parts:
                reason = part(entity, colour)
                if reason is not None:
                    return reason
            return None

        return evidence

    def both(self) -> Part:
        """Read parts joined by "and"."""
        parts = [self.one()]
        while self.take("and"):
            parts.append(self.one())

        def evidence(entity: int, colour: Colour) -> Reason:
            reasons: Evidence = ()
            for part in parts:
                reason = part(entity, colour)
                if reason is None:
                    return None
                reasons += reason
            return reasons

        return evidence

    def one(self) -> Part:
        """Read a negation, a bracket, a count, a chain or a fact."""
        if self.take("not"):
            return self.negation()
        if self.next == "(":
            return self.bracket()
        is_count = self.take("count")
        relation = self.relation()
        if is_count:
            return self.count(relation)
        if self.next in SIGNS:
            return self.comparison(relation)
        if self.next == "(":
            return self.chain(relation, self.bracket())
        return self.fact(relation)

    def negation(self) -> Part:
        """Read what is negated."""
        begin = self.taken
        part = self.one()
        missing = f"not stated: {' '.join(self.words[begin : self.taken])}"

        def evidence(entity: int, colour: Colour) -> Reason:
            if part(entity, colour) is None:
                return (missing,)
            return None

        return evidence

    def fact(self, relation: _Relation) -> Part:
        """Read a value; the colour of what is shown is seen, not looked up."""
        names = []
        while name := self.take_name():
            names.append(name.strip('"'))
        value = " ".join(names)
        if not value:
            raise self.wrong(f"a value of {relation.name}")
        is_colour = relation.name == COLOUR_RELATION
        colours: Collection[str] = ()
        if is_colour:
            colours = self.colours
        for colour in colours:
            if name_key(colour) == name_key(value):
                value = colour
        ids = self.values(relation, value)
        if not ids and value not in colours:
            known = set(map(self.name, self.tails(relation)))
            raise unknown_name(f"value of {relation.name}", value, known.union(colours))
        stated = self.leading_to(relation, ids)
        if not is_colour:
            return stated

        def evidence(entity: int, colour: Colour) -> Reason:
            if colour is None:
                return stated(entity, colour)
            if colour == value:
                return (f"the image shows {value}",)
            return None

        return evidence

    def values(self, relation: _Relation, value: str) -> set[int]:
        """Return the ids of what a value names, and of numbers and dates equal to it."""
        ids = set(self.graph.values(value))
        wanted = _quantity(value)
        if wanted is not None:
            for tail, quantity in self.quantities(relation):
                if quantity == wanted:
                    ids.add(tail)
        return ids

    def chain(self, relation: _Relation, of: Part) -> Part:
        """Return the part that is true where a relation leads to something of which one is."""

        def evidence(entity: int, colour: Colour) -> Reason:
            return next(self.reasons(entity, colour, relation, of), None)

        return evidence

    def leading_to(self, relation: _Relation, ids: Collection[int]) -> Part:
        """Return the part that is true where a relation leads to one of some entities."""
        return self.chain(relation, lambda tail, colour: () if tail in ids else None)

    def comparison(self, relation: _Relation) -> Part:
        """Read a comparison with a number or a date."""
        compare = SIGNS[self.take(*SIGNS)]
        wanted = _quantity(self.take_name())
        if wanted is None:
            raise self.wrong("a number or a date")
        kind, limit = wanted
        fits = {}
        for tail, (kind_of_tail, number) in self.quantities(relation):
            if kind_of_tail == kind:
                fits[tail] = compare(number, limit)
        if not fits:
            raise UserError(
                f"The question {self.text!r}: the graph states no {kind} by {relation.name}."
            )
        return self.leading_to(relation, {tail for tail in fits if fits[tail]})

    def tails(self, relation: _Relation) -> list[int]:
        """Return the ids of what a relation leads to."""
        has_relation = np.isin(self.graph.relations, relation.ids)
        return np.unique(self.graph.tails[has_relation]).tolist()

    def quantities(self, relation: _Relation) -> Iterator[tuple[int, _Quantity]]:
        """Yield the numbers and dates that a relation leads to, each after its id."""
        for tail in self.tails(relation):
            quantity = _quantity(self.name(tail))
            if quantity is not None:
                yield tail, quantity

    def name(self, entity: int) -> str:
        """Return the last part of the name of an entity."""
        return local_name(self.graph.names[entity])

    def count(self, relation: _Relation) -> Part:
        """Read a comparison with the number of values of a relation."""
        of: Part = _anything
        if self.next == "(":
            of = self.bracket()
        sign = self.take(*SIGNS)
        number = self.take_name() if sign else ""
        if not number.isdecimal() or len(number) > 9:
            raise self.wrong("a comparison such as >= 2")

        def evidence(entity: int, colour: Colour) -> Reason:
            reasons = list(self.reasons(entity, colour, relation, of))
            if not SIGNS[sign](len(reasons), int(number)):
                return None
            return (*chain.from_iterable(reasons), f"counted: {len(reasons)}")

        return evidence

    def bracket(self) -> Part:
        """Read a part in brackets."""
        self.take("(")
        part = self.either()
        if not self.take(")"):
            raise self.wrong("')'")
        return part

    def relation(self) -> _Relation:
        """Read one word: the name of a relation, its last part or its label."""
        word = self.take_name().strip('"')
        if not word:
            raise self.wrong("a relation")
        names = self.graph.relation_names
        if name_key(local_name(word)) in _COLOUR:
            # the image answers it, whoever else states it
            ids = names.find_local(COLOUR_RELATION)
            name = COLOUR_RELATION
        else:
            ids = [self.graph.relation_id(word)]
            name = local_name(names[ids[0]])
        self.has_relation = True
        return _Relation(name, ids)

    def reasons(
        self, entity: int, colour: Colour, relation: _Relation, of: Part
    ) -> Iterator[Evidence]:
        """Yield each triple of a relation whose head is an entity, and why its tail fits."""
        graph = self.graph
        for row in graph.out_rows(entity):
            if graph.relations[row] not in relation.ids:
                continue
            tail = int(graph.tails[row])
            reason = of(tail, colour if tail == entity else None)
            if reason is not None:
                fact = f"{self.name(entity)} {relation.name} {self.name(tail)}"
                yield fact, *reason
