"""Closure of a graph: what follows from its axioms, and what each new triple follows from."""

from collections.abc import Iterable
from itertools import chain, filterfalse
from typing import NamedTuple

import numpy as np

from knowarm.knowledge.graph.axioms import Axioms
from knowarm.knowledge.graph.denials import denial
from knowarm.knowledge.graph.derivations import Derivations, mixed
from knowarm.knowledge.graph.graph import Ids, KnowledgeGraph, Names
from knowarm.knowledge.graph.owl import (
    DENIALS,
    DENIALS_BELOW,
    FACTS,
    FRESH,
    HIERARCHY,
    IS_A,
    NOT_A,
    OWL,
    WORDS,
    has_axioms,
)
from knowarm.knowledge.graph.rules import (
    COLUMNS,
    MOST,
    MOST_ROUNDS,
    Reasoner,
    TooManyError,
    steps_of,
)
from knowarm.knowledge.graph.terms import RDF, RDFS, local_name

_VOCABULARIES = (OWL, RDF, RDFS, "http://www.w3.org/2001/XMLSchema#")
_STRUCTURE = (
    "onProperty intersectionOf unionOf oneOf complementOf members first rest "
    "assertionProperty"
)
_CLASS_HEADS = "subClassOf equivalentClass disjointWith complementOf onProperty"
_CLASS_TAILS = (
    "subClassOf equivalentClass disjointWith complementOf type domain range "
    "someValuesFrom"
)
_SAYS_SOMETHING = (*IS_A, WORDS["sameAs"])
_FEW_DENIALS = 1_000
"""So many denials about subclasses are added to any graph, and to large ones one per triple."""


class Closed(NamedTuple):
    """A graph with all that follows."""

    graph: KnowledgeGraph
    message: str
    """What was added and what was not, in one line; empty if there is nothing to say."""


def closed(graph: KnowledgeGraph) -> Closed:
    """Add what follows from the axioms of RDFS and OWL 2; other graphs are returned as they are.

    What was added is marked: `KnowledgeGraph.because` tells what it follows from.
    """
    graph = graph.stated()
    if not has_axioms(graph):
        return Closed(graph, "")
    return _Closure(graph).result()


class _Closure:
    """A graph and its axioms as numbers for the reasoner, and what the reasoner finds as a graph.

    Attributes:
        names: names by number, the relations first.
        ids: numbers by name.
        notes: what was not added, and what is wrong.
    """

    def __init__(self, graph: KnowledgeGraph) -> None:
        self.graph = graph
        self.axioms = Axioms(graph)
        self.notes = list[str]()
        relations = {*graph.relation_names, *self.axioms.properties, *WORDS.values()}
        relations.update(*self.axioms.plain.items())
        others = dict.fromkeys(graph.names)
        for head, relation, tail in self.axioms.encoded:
            relations.add(relation)
            others.update({head: None, tail: None})
        self._relations = len(relations)
        self.names = sorted(relations)
        self.names += filterfalse(relations.__contains__, others)
        self.ids = dict(zip(self.names, range(len(self.names)), strict=True))
        self._of_entity = self._numbers(graph.names)
        is_literal = np.zeros(len(self.names), bool)
        is_literal[self._of_entity[graph.names.literals]] = True
        self._is_part = np.zeros(len(self.names), bool)
        structures = graph.names.at(np.unique(graph.heads[self._stated_by(_STRUCTURE)]))
        parts = [name for name in structures if name.startswith("_:")]
        self._is_part[self._numbers(parts)] = True
        constants = dict(zip(WORDS, self._numbers(WORDS.values()), strict=True))
        self.reasoner = Reasoner(
            len(relations),
            is_literal,
            self._is_part,
            constants,
        )

    def _numbers(self, names: Iterable[str]) -> Ids:
        return np.array(list(map(self.ids.__getitem__, names)), np.int32)

    def _stated_by(self, words: str) -> Ids:
        """Return whether each triple has one of some relations, (n,) bool."""
        names = map(WORDS.__getitem__, words.split())
        return np.isin(self.graph.relations, self.graph.relation_names.find_all(names))

    def result(self) -> Closed:
        """Reason, and return the graph with what follows."""
        self._state()
        try:
            self.reasoner.run(HIERARCHY, MOST, only_named=True)
            self.reasoner.run(FACTS, MOST)
        except TooManyError:
            return Closed(
                self.graph,
                f"more than {MOST:,} triples, or one over more than {MOST_ROUNDS} steps, follow "
                "from its axioms (RDFS, OWL 2), and none was added; leave axioms out that you do "
                "not need",
            )
        self._deny()
        return self._extended()

    def _state(self) -> None:
        """Tell the reasoner the triples, the axioms, and what is a class."""
        graph = self.graph
        relations = self._numbers(graph.relation_names)
        columns = [
            self._of_entity[graph.heads],
            relations[graph.relations],
            self._of_entity[graph.tails],
        ]
        confidence = graph.probabilities(np.arange(len(graph)))
        stated = steps_of(np.stack(columns, axis=1), confidence)
        batch = self.reasoner.add(stated)
        numbers = np.searchsorted(batch.steps["key"], stated["key"])
        encoded = self.axioms.encoded
        triples = self._numbers(chain(*encoded)).reshape(-1, 3)
        sure = np.array(list(map(self.axioms.sure, encoded.values())))
        steps = steps_of(triples, sure)
        for premises, rows in zip(steps["premises"], encoded.values(), strict=True):
            premises[: len(rows)] = numbers[list(rows)]
        self.reasoner.add(steps)
        if self.axioms.properties:
            self.reasoner.add(steps_of(self._kinds()))

    def _kinds(self) -> Ids:
        """Return by which relation each entity would be put into a class, (E, 3)."""
        graph = self.graph
        is_class = np.zeros(len(graph.names), bool)
        is_class[graph.heads[self._stated_by(_CLASS_HEADS)]] = True
        is_class[graph.tails[self._stated_by(_CLASS_TAILS)]] = True
        for entity in graph.names.find_all((WORDS["Class"], RDFS + "Class")):
            is_class[graph.heads[graph.in_rows(entity)]] = True
        kinds = np.full((len(is_class), 3), self.ids[WORDS["kind"]])
        kinds[:, 0] = self._of_entity
        kinds[:, 2] = np.where(is_class, self.ids[IS_A[1]], self.ids[IS_A[0]])
        return kinds[~self._is_part[self._of_entity]]

    def _deny(self) -> None:
        """Add what does not hold, of subclasses of excluded classes only if they are few."""
        try:
            self.reasoner.run(DENIALS, MOST)
        except TooManyError:
            self.notes.append(f"more than {MOST:,} denials were left out")
            return
        most = max(_FEW_DENIALS, len(self.graph))
        try:
            self.reasoner.run(DENIALS_BELOW, most)
        except TooManyError:
            self.notes.append(
                f"disjoint classes deny each other, and not the more than {most:,} pairs of their "
                "subclasses"
            )

    def _extended(self) -> Closed:
        """Return the graph with what the reasoner added, as far as it says something."""
        steps = self.reasoner.everything()
        heads, relations, tails = (steps[column] for column in COLUMNS)
        encoded = self._numbers(self.axioms.plain)
        plain = np.arange(len(self.names))
        plain[encoded] = self._numbers(self.axioms.plain.values())
        relations = plain[relations]
        is_end = self._is_end()
        is_shown = self._tells()[relations] & is_end[heads] & is_end[tails]
        count = len(self.graph)
        is_shown[:count] = True

        used = [self.names[relation] for relation in np.unique(relations[is_shown])]
        relation_names = Names(sorted({*self.graph.relation_names, *used}))
        entity_of = self._inverse(self._of_entity)
        relation_of = self._inverse(self._numbers(relation_names))
        columns = [entity_of[heads], relation_of[relations], entity_of[tails]]
        triples = np.stack(columns, axis=1)
        triples[~is_shown] = -1

        # Of equal triples the stated one stays, or else the surest.
        keys = mixed([columns[1], columns[0], columns[2]], len(self.names))
        confidence = steps["confidence"]
        shown = np.flatnonzero(is_shown)
        is_derived = shown >= count
        order = np.lexsort((-confidence[shown], is_derived, keys[shown]))
        shown = shown[order]
        _, firsts = np.unique(keys[shown], return_index=True)
        kept = shown[firsts]
        derived = kept[kept >= count]
        if not len(derived):
            return Closed(self.graph, self._message(0))
        graph = self.graph.with_triples(triples[kept], relation_names)
        graph.derivations = Derivations(triples, steps["premises"], derived)
        doubtful = self.graph.own_confidence()
        for step in derived[confidence[derived] < 1]:
            triple = graph.named(triples[step])
            doubtful[triple] = float(confidence[step])
        graph.confidence = doubtful
        self._contradictions(graph)
        return Closed(graph, self._message(len(derived)))

    def _inverse(self, numbers: Ids) -> Ids:
        """Return the index of each number in an array of numbers; -1 of others."""
        index = np.full(len(self.names), -1, np.int32)
        index[numbers] = np.arange(len(numbers))
        return index

    def _tells(self) -> Ids:
        """Return whether triples of each relation say something about things, (R,) bool."""
        own = (FRESH, "_:", *_VOCABULARIES)
        relations = self.names[: self._relations]
        tells = [not n.startswith(own) or n in _SAYS_SOMETHING for n in relations]
        return np.array(tells)

    def _is_end(self) -> Ids:
        """Return whether each is a thing, a class or a value, and no part of an axiom."""
        is_end = np.zeros(len(self.names), bool)
        is_end[self._of_entity] = True
        for name in _VOCABULARIES:
            own = self.graph.names.beginning_with(name)
            is_end[self._of_entity[own]] = False
        return is_end & ~self._is_part

    def _contradictions(self, graph: KnowledgeGraph) -> None:
        """Note what is both said and denied."""
        affirming = dict(zip(NOT_A, IS_A, strict=True))
        affirming[WORDS["differentFrom"]] = WORDS["sameAs"]
        for name in self.axioms.properties:
            affirming[denial(name)] = name
        both = []
        for relation in graph.relation_names.find_all(sorted(affirming)):
            for triple in graph.rows(graph.relations == relation):
                head, denying, tail = triple
                stated = (head, affirming[denying], tail)
                if stated in graph:
                    both.append(" ".join(map(local_name, stated)))
        if both:
            self.notes.append(
                f"it contradicts itself: {len(both)} triples are both stated and denied, such as "
                f"{both[0]!r}"
            )

    def _message(self, count: int) -> str:
        """Return what was added and what was not, in one line."""
        said = []
        if count:
            said.append(
                f"{count:,} triples follow from axioms (RDFS, OWL 2) and were added"
            )
        kinds = [
            f"{number} {kind}" for kind, number in sorted(self.axioms.unused.items())
        ]
        if kinds:
            said.append(f"axioms from which nothing is read: {', '.join(kinds)}")
        return "; ".join((*said, *self.notes))
