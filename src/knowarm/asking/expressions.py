"""Questions in conditions: facts, chains, counts, comparisons, "and", "or" and "not".

    usedFor drinking and not hasColor blue
    hasPart spout or (isMadeOf wood and isLocatedIn garden)
    usedFor (relatedTo tea)                    a use that is related to tea
    count hasPart >= 3                         objects with three parts or more
    count contains (isA beverage) = 1
    price < 6 and made >= 2020-01-01           numbers and dates
    is mug and hasColor red                    an object by its name or class
    leftOf (is vase) or rightmost              where it stands in the image

"not" binds tighter than "and", and that tighter than "or". A value reaches to the next keyword or
bracket; in double quotes it may hold any of them, and double quotes behind a backslash.
"""

import operator
import re
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from itertools import chain
from math import prod
from typing import Any, NamedTuple

import numpy as np

from knowarm.asking.judgements import (
    Individual,
    Judgement,
    Part,
    certain,
    conjunction,
    disjunction,
    negated,
    settled,
    surest,
    undescribed,
)
from knowarm.asking.lexicon import WORDS
from knowarm.asking.places import (
    DISTANCES,
    ENDS,
    SIDES,
    Superlative,
    at_end,
    beside,
    by_distance,
)
from knowarm.asking.quotes import QUOTED, unquoted
from knowarm.asking.relations import is_colour, kind_relations
from knowarm.errors import UserError, unknown_name
from knowarm.knowledge.graph.denials import opposed
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.individuals import Tellers, values_of
from knowarm.knowledge.graph.terms import local_name, name_key
from knowarm.questions import COLOUR_RELATION

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

_TOKEN = re.compile(QUOTED + r'|[()]|[<>=!]=|[<>=]|[^\s()<>=!"]+|["!]')
_NO_NAMES = {"", "and", "or", "not", "count", "(", ")", *SIGNS}


_KINDS = {float: "number", datetime: "date"}
"""Names of the types of what can be compared."""


def _quantity(text: str) -> float | datetime | None:
    """Return the number or the ISO date that a text is."""
    with suppress(ValueError):
        return float(text)
    with suppress(ValueError):
        return datetime.fromisoformat(text).replace(tzinfo=UTC)
    return None


def _anything(individual: Individual) -> Judgement:
    """Return that a value counts, whatever it is."""
    return Judgement(True)


class _Relation(NamedTuple):
    """A relation of a question: its name, and its ids and those that deny it in the graph."""

    name: str
    ids: list[int]
    opposed: list[int]


class QuestionReader:
    """Reads a question word by word, by recursive descent.

    Attributes:
        taken: number of words that were read.
        has_relation: whether a relation was read; no sentence begins with one.
        has_places: whether the answers depend on where things stand.
    """

    def __init__(
        self,
        text: str,
        graph: KnowledgeGraph,
        colours: Collection[str],
        objects: Collection[str],
    ) -> None:
        self.text = text
        self.graph = graph
        self.colours = colours
        self.objects = objects
        self.words = [*_TOKEN.findall(text), "", ""]
        self.taken = 0
        self.tellers = Tellers(graph)
        self.has_relation = False
        self.has_places = False
        deep = self.words.count("(") + self.words.count("not")
        count = len(self.words) - 2
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

    @property
    def after_next(self) -> str:
        """The word behind the next one; empty at the end."""
        return self.words[self.taken + 1]

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
        if len(parts) == 1:
            return parts[0]
        return lambda individual: disjunction(part(individual) for part in parts)

    def both(self) -> Part:
        """Read parts joined by "and"; superlatives compare what all the others are true of."""
        parts = [self.one()]
        while self.take("and"):
            parts.append(self.one())
        if len(parts) == 1:
            return parts[0]
        superlatives = [part for part in parts if isinstance(part, Superlative)]
        others = [part for part in parts if not isinstance(part, Superlative)]

        def plain(individual: Individual) -> Judgement:
            return conjunction(part(individual) for part in others)

        def judgement(individual: Individual) -> Judgement:
            rivals: list[Individual] = []
            if superlatives:
                rivals = [rival for rival in individual.scene if plain(rival).answers]
            compared = [part.among(individual, rivals) for part in superlatives]
            return conjunction([plain(individual), *compared])

        return judgement

    def one(self) -> Part:
        """Read a negation, a bracket, a place, a name, a count, a chain or a fact."""
        if self.take("not"):
            part = self.one()
            return lambda individual: negated(part(individual))
        if self.next == "(":
            return self.bracket()
        is_place = self.next in (*SIDES, *DISTANCES) and self.after_next == "("
        if is_place or self.next in ENDS:
            return self.place()
        if self.next == "is" and self.after_next not in _NO_NAMES:
            return self.kind()
        is_count = self.take("count")
        relation = self.relation()
        if is_count:
            return self.count(relation)
        if self.next in SIGNS:
            return self.comparison(relation)
        if self.next == "(":
            begin = self.taken
            of = self.bracket()
            text = f"{relation.name} {self.text_from(begin)}"
            return self.chain(relation, of, text)
        return self.fact(relation)

    def text_from(self, begin: int) -> str:
        """Return the words that were taken from one on."""
        text = " ".join(self.words[begin : self.taken])
        return text.replace("( ", "(").replace(" )", ")")

    def place(self) -> Part:
        """Read a condition on where something stands in the image."""
        self.has_places = True
        begin = self.taken
        name = self.take(self.next)
        if name in ENDS:
            return at_end(name)
        of = self.bracket()
        text = self.text_from(begin)
        if name in SIDES:
            return beside(text, name, of)
        return by_distance(text, name, of)

    def kind(self) -> Part:
        """Read what something is: its name, or a class that the graph puts it into."""
        self.take("is")
        self.has_relation = self.next not in WORDS.ignored  # but "is the mug red"
        value = self.value("a name or class")
        kinds = _Relation("is", *kind_relations(self.graph))
        key = name_key(value)
        ids = values_of(self.graph, value, self.graph.has_node)
        names = {name for name in self.objects if name_key(name) == key}
        classes = self.tails(kinds)
        if not names and ids.isdisjoint(classes):
            known = {*self.objects, *map(self.name, classes)}
            raise unknown_name("object or class", value, known)
        by_graph = self.leading_to(kinds, ids, f"is {value}")

        def judgement(individual: Individual) -> Judgement:
            is_named = individual.name in names
            stated = certain(False, f"it is {individual.name}")
            if ids and not is_named:
                stated = by_graph(individual)
            if stated.answers or not (is_named or individual.entity in ids):
                return stated
            return certain(True, f"it is {value}")

        return judgement

    def value(self, expected: str) -> str:
        """Read a value: all words to the next keyword or bracket."""
        names = []
        while name := self.take_name():
            names.append(unquoted(name))
        value = " ".join(names)
        if not value:
            raise self.wrong(expected)
        return value

    def fact(self, relation: _Relation) -> Part:
        """Read a value; the colour of what is shown is seen, not looked up."""
        value = self.value(f"a value of {relation.name}")
        is_seen = relation.name == COLOUR_RELATION
        colours = self.colours if is_seen else ()
        for colour in colours:
            if name_key(colour) == name_key(value):
                value = colour
        ids = self.values(relation, value)
        if not ids and value not in colours:
            known = set(map(self.name, self.tails(relation)))
            raise unknown_name(f"value of {relation.name}", value, known.union(colours))
        stated = self.leading_to(relation, ids, f"{relation.name} {value}")
        if not is_seen:
            return stated

        def judgement(individual: Individual) -> Judgement:
            colour = individual.colour
            if colour is None:
                return stated(individual)
            return certain(colour == value, f"the image shows {colour}")

        return judgement

    def values(self, relation: _Relation, value: str) -> set[int]:
        """Return the ids of what a value names, and of numbers and dates equal to it."""
        tails = set(self.tails(relation))
        ids = values_of(self.graph, value, tails.__contains__)
        wanted = _quantity(value)
        if wanted is not None:
            quantities = self.quantities(relation)
            ids.update(tail for tail in quantities if quantities[tail] == wanted)
        return ids

    def chain(self, relation: _Relation, of: Part, text: str) -> Part:
        """Return the part that is true where a relation leads to something of which one is."""
        if self.graph.missing:  # they may state it
            text += f" (imported and not at hand: {', '.join(self.graph.missing)})"

        def judgement(individual: Individual) -> Judgement:
            if individual.entity is None:
                return undescribed(individual)
            for entities in self.tellers.of(individual.entity, relation.ids):
                facts = partial(self.facts, individual, entities, of)
                stated = _evidence(facts(relation.ids))
                denied = _evidence(facts(relation.opposed))
                if stated is not None or denied is not None:
                    return settled(stated, denied, text)
            return settled(None, None, text)

        return judgement

    def leading_to(self, relation: _Relation, ids: Collection[int], text: str) -> Part:
        """Return the part that is true where a relation leads to one of some entities."""
        return self.chain(relation, lambda tail: Judgement(tail.entity in ids), text)

    def comparison(self, relation: _Relation) -> Part:
        """Read a comparison with a number or a date."""
        sign = self.take(*SIGNS)
        wanted_text = self.take_name()
        wanted = _quantity(wanted_text)
        if wanted is None:
            raise self.wrong("a number or a date")
        fits = {}
        for tail, quantity in self.quantities(relation).items():
            if type(quantity) is type(wanted):
                fits[tail] = SIGNS[sign](quantity, wanted)
        if not fits:
            kind = _KINDS[type(wanted)]
            raise UserError(
                f"The question {self.text!r}: the graph states no {kind} by {relation.name}."
            )
        text = f"{relation.name} {sign} {wanted_text}"
        fitting = {tail for tail in fits if fits[tail]}
        is_fitting = self.leading_to(relation, fitting, text)
        others = self.leading_to(relation, fits.keys() - fitting, text)

        def judgement(individual: Individual) -> Judgement:
            fitting = is_fitting(individual)
            another = others(individual)
            if another.holds and not fitting.is_stated:
                return negated(another)
            return fitting

        return judgement

    def tails(self, relation: _Relation) -> list[int]:
        """Return the ids of what a relation leads to."""
        has_relation = np.isin(self.graph.relations, relation.ids)
        return np.unique(self.graph.tails[has_relation]).tolist()

    def quantities(self, relation: _Relation) -> dict[int, float | datetime]:
        """Return the numbers and dates that a relation leads to, by id."""
        quantities = {}
        for tail in self.tails(relation):
            quantity = _quantity(self.name(tail))
            if quantity is not None:
                quantities[tail] = quantity
        return quantities

    def name(self, entity: int) -> str:
        """Return the last part of the name of an entity."""
        return local_name(self.graph.names[entity])

    def count(self, relation: _Relation) -> Part:
        """Read a comparison with the number of values of a relation."""
        of = self.bracket() if self.next == "(" else _anything
        sign = self.take(*SIGNS)
        number = self.take_name() if sign else ""
        if not number.isdecimal() or len(number) > 9:
            raise self.wrong("a comparison such as >= 2")

        def judgement(individual: Individual) -> Judgement:
            if individual.entity is None:
                return undescribed(individual)
            tellers = self.tellers.of(individual.entity, relation.ids)
            entities = list(chain.from_iterable(tellers))
            facts = list(self.facts(individual, entities, of, relation.ids))
            evidence = chain.from_iterable(fact.evidence for fact in facts)
            is_it = SIGNS[sign](len(facts), int(number))
            return certain(is_it, *evidence, f"counted: {len(facts)}")

        return judgement

    def bracket(self) -> Part:
        """Read a part in brackets."""
        self.take("(")
        part = self.either()
        if not self.take(")"):
            raise self.wrong("')'")
        return part

    def relation(self) -> _Relation:
        """Read one word: the name of a relation, its last part or its label."""
        word = unquoted(self.take_name())
        if not word:
            raise self.wrong("a relation")
        names = self.graph.relation_names
        if is_colour(local_name(word)):  # the image answers it, whoever states it
            name = COLOUR_RELATION
            ids = names.find_local(name)
            denying = list[int]()
        else:
            relation = self.graph.find_relation(word)
            name = word if relation is None else names[relation]
            ids = [] if relation is None else [relation]
            denying = opposed(self.graph, name)
            if not ids and (not denying or word in WORDS.ignored):
                self.graph.relation_id(word)  # which raises the error
        self.has_relation = True
        return _Relation(local_name(name), ids, denying)

    def facts(
        self,
        individual: Individual,
        entities: Collection[int],
        of: Part,
        relations: Collection[int],
    ) -> Iterator[Judgement]:
        """Yield each fact that entities tell of an individual by relations, with its probability.

        A part is true of its tail; what several entities tell alike counts once.
        """
        heads = self.tellers.facts(entities, relations)
        for (relation, tail), head in heads.items():
            told = Individual(tail)
            if tail == individual.entity:
                told = individual
            fits = of(told)
            if fits.answers:
                yield from self.told(head, relation, tail, fits)

    def told(
        self, head: int, relation: int, tail: int, fits: Judgement
    ) -> Iterator[Judgement]:
        """Yield the judgement that a triple makes, whose tail fits; none of one that is doubted."""
        graph = self.graph
        triple = (graph.names[head], graph.relation_names[relation], graph.names[tail])
        sure = graph.confidence.get(triple, 1.0)
        if sure == 0:
            return
        text = " ".join(map(local_name, triple))
        if sure < 1:
            text += f" ({sure:.2g})"
        grounds = graph.grounds(triple)
        if grounds != (triple,):
            reasons = [" ".join(map(local_name, ground)) for ground in grounds]
            text += f" because {', '.join(reasons)}"
        yield Judgement(True, (text, *fits.evidence), sure * fits.probability)


def _evidence(facts: Iterator[Judgement]) -> Judgement | None:
    """Return the most probable fact with the probability that one of all holds, None without."""
    judgements = list(facts)
    if not judgements:
        return None
    is_false = prod(1 - fact.probability for fact in judgements)
    return replace(surest(judgements), probability=1 - is_false)
