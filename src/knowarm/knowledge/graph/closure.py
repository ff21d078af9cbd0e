"""Closure of a graph: what follows from its axioms, and what each new triple follows from."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from knowarm.knowledge.graph.axioms import Axioms, denied, general
from knowarm.knowledge.graph.denials import denial
from knowarm.knowledge.graph.derivations import Derivations
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
    MOST,
    MOST_ROUNDS,
    Reasoner,
    TooManyError,
    mixed,
    stated,
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
    """

    def __init__(self, graph: KnowledgeGraph) -> None:
        self.graph = graph
        self.axioms = Axioms(graph)
        self.notes = list[str]()
        relations = self._relation_names()
        others = dict.fromkeys(graph.names)
        for head, _, tail, _ in self.axioms.encoded:
            others[head] = None
            others[tail] = None
        self.names = sorted(relations)
        self.names += filter(lambda name: name not in relations, others)
        self.ids = dict(zip(self.names, range(len(self.names)), strict=True))
        self._of_entity = self._numbers(graph.names)
        is_literal = np.zeros(len(self.names), bool)
        is_literal[self._numbers(graph.names.starting_with('"'))] = True
        self._is_part = self._parts()
        constants = dict(zip(WORDS, self._numbers(WORDS.values()), strict=True))
        self.reasoner = Reasoner(len(relations), is_literal, self._is_part, constants)

    def _relation_names(self) -> set[str]:
        properties = self.axioms.properties
        relations = {*self.graph.relation_names, *properties, *WORDS.values()}
        for name in properties:
            relations.update((general(name), denied(name), denial(name)))
        for _, relation, _, _ in self.axioms.encoded:
            relations.add(relation)
        return relations

    def _numbers(self, names: Iterable[str]) -> Ids:
        return np.array(list(map(self.ids.__getitem__, names)), np.int32)

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
        heads = self._of_entity[graph.heads]
        tails = self._of_entity[graph.tails]
        triples = np.stack([heads, relations[graph.relations], tails], axis=1)
        confidence = np.ones(len(triples))
        if graph.confidence:
            for row, triple in enumerate(graph):
                confidence[row] = graph.confidence.get(triple, 1.0)
        batch = self.reasoner.add(stated(triples, confidence))
        keys = mixed([triples[:, 1], triples[:, 0], triples[:, 2]], len(self.names))
        numbers = np.searchsorted(batch.keys, keys)
        encoded = np.empty((len(self.axioms.encoded), 3), np.int64)
        news = stated(encoded)
        for number, (head, relation, tail, rows) in enumerate(self.axioms.encoded):
            encoded[number] = [self.ids[head], self.ids[relation], self.ids[tail]]
            news.premises[number, : len(rows)] = numbers[list(rows)]
        self.reasoner.add(news)
        if self.axioms.properties:
            self.reasoner.add(stated(self._kinds()))

    def _kinds(self) -> Ids:
        """Return by which relation each entity would be put into a class, (E, 3)."""
        is_class = np.zeros(len(self.graph.names), bool)
        is_class[self.graph.heads[self._stated_by(_CLASS_HEADS)]] = True
        is_class[self.graph.tails[self._stated_by(_CLASS_TAILS)]] = True
        for name in (WORDS["Class"], RDFS + "Class"):
            entity = self.graph.names.find(name)
            if entity is not None:
                is_class[self.graph.heads[self.graph.in_rows(entity)]] = True
        kinds = np.full((len(is_class), 3), self.ids[WORDS["kind"]])
        kinds[:, 0] = self._of_entity
        kinds[:, 2] = np.where(is_class, self.ids[IS_A[1]], self.ids[IS_A[0]])
        return kinds[~self._is_part[kinds[:, 0]]]

    def _stated_by(self, words: str) -> Ids:
        """Return whether each triple has one of some relations, (n,) bool."""
        relations = list[int]()
        for word in words.split():
            relation = self.graph.relation_names.find(WORDS[word])
            if relation is not None:
                relations.append(relation)
        return np.isin(self.graph.relations, relations)

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
        everything = self.reasoner.everything()
        heads, relations, tails = everything.columns
        premises = everything.premises
        confidence = everything.confidence
        relations = self._plain()[relations]
        is_shown = self._tells()[relations]
        is_shown &= self._ends()[heads] & self._ends()[tails]
        count = len(self.graph)
        is_shown[:count] = True

        used = map(self.names.__getitem__, np.unique(relations[is_shown]))
        relation_names = Names(sorted({*self.graph.relation_names, *used}))
        entity_of = self._inverse(self._of_entity)
        relation_of = self._inverse(self._numbers(relation_names))
        columns = [entity_of[heads], relation_of[relations], entity_of[tails]]
        triples = np.stack(columns, axis=1)
        triples[~is_shown] = -1

        keys = mixed(columns, len(self.names))
        derived = count + np.flatnonzero(is_shown[count:])
        derived = derived[~np.isin(keys[derived], keys[:count])]
        derived = derived[np.lexsort((-confidence[derived], keys[derived]))]
        _, surest = np.unique(keys[derived], return_index=True)
        derived = derived[surest]
        if not len(derived):
            return Closed(self.graph, self._message(0))
        kept = np.concatenate([np.arange(count), derived])
        graph = KnowledgeGraph(
            self.graph.names,
            relation_names,
            triples[kept],
            nodes=self.graph.nodes,
            labels=self.graph.labels,
            prefixes=self.graph.prefixes,
            missing=self.graph.missing,
            derivations=Derivations(triples, premises, derived),
        )
        doubtful = self.graph.own_confidence()
        for step in derived[confidence[derived] < 1]:
            head, relation, tail = triples[step]
            triple = (graph.names[head], relation_names[relation], graph.names[tail])
            doubtful[triple] = float(confidence[step])
        graph.confidence = doubtful
        self._contradictions(graph)
        return Closed(graph, self._message(len(derived)))

    def _inverse(self, numbers: Ids) -> Ids:
        """Return the index of each number in an array of numbers; -1 of others."""
        index = np.full(len(self.names), -1, np.int32)
        index[numbers] = np.arange(len(numbers))
        return index

    def _plain(self) -> Ids:
        """Return the number of the relation that a graph has for each."""
        plain = np.arange(len(self.names))
        for name in self.axioms.properties:
            plain[self.ids[general(name)]] = self.ids[name]
            plain[self.ids[denied(name)]] = self.ids[denial(name)]
        plain[self.ids[WORDS["excludes"]]] = self.ids[NOT_A[1]]
        return plain

    def _tells(self) -> Ids:
        """Return whether triples of each relation say something about things."""
        tells = np.zeros(len(self.names), bool)
        for number, name in enumerate(self.names):
            is_own = name.startswith((FRESH, "_:", *_VOCABULARIES))
            tells[number] = not is_own or name in _SAYS_SOMETHING
        return tells

    def _ends(self) -> Ids:
        """Return whether each is a thing, a class or a value, and no part of an axiom."""
        ends = np.zeros(len(self.names), bool)
        ends[self._of_entity] = True
        for name in _VOCABULARIES:
            ends[self._numbers(self.graph.names.starting_with(name))] = False
        return ends & ~self._is_part

    def _parts(self) -> Ids:
        """Return whether each is an anonymous part of an axiom."""
        is_part = np.zeros(len(self.names), bool)
        heads = self.graph.heads[self._stated_by(_STRUCTURE)]
        for name in self.graph.names.at(np.unique(heads)):
            is_part[self.ids[name]] = name.startswith("_:")
        return is_part

    def _contradictions(self, graph: KnowledgeGraph) -> None:
        """Note what is both said and denied."""
        relations = dict(zip(NOT_A, IS_A, strict=True))
        relations[WORDS["differentFrom"]] = WORDS["sameAs"]
        for name in self.axioms.properties:
            relations[denial(name)] = name
        both = list[str]()
        for denying, affirming in sorted(relations.items()):
            relation = graph.relation_names.find(denying)
            if relation is None or graph.relation_names.find(affirming) is None:
                continue
            for row in np.flatnonzero(graph.relations == relation):
                head = graph.names[graph.heads[row]]
                tail = graph.names[graph.tails[row]]
                if (head, affirming, tail) in graph:
                    both.append(" ".join(map(local_name, (head, affirming, tail))))
        if both:
            self.notes.append(
                f"it contradicts itself: {len(both)} triples are both stated and denied, such as "
                f"{both[0]!r}"
            )

    def _message(self, count: int) -> str:
        """Return what was added and what was not, in one line."""
        said = list[str]()
        if count:
            said.append(
                f"{count:,} triples follow from axioms (RDFS, OWL 2) and were added"
            )
        if self.axioms.unused:
            kinds = sorted(self.axioms.unused.items())
            unused = ", ".join(f"{number} {kind}" for kind, number in kinds)
            said.append(f"axioms from which nothing is read: {unused}")
        return "; ".join((*said, *self.notes))
