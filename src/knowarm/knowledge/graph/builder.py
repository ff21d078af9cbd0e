"""Construction of graphs from triples of names, and union and difference of graphs."""

from array import array
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from itertools import count
from operator import itemgetter

import numpy as np

from knowarm.errors import UserError
from knowarm.knowledge.graph.closure import closed
from knowarm.knowledge.graph.graph import Ids, KnowledgeGraph, Names, Triple
from knowarm.knowledge.graph.terms import LABEL_RELATIONS, blank_names, parse_literal

_Labels = Mapping[str, str]
"""Labels by name."""


class GraphBuilder:
    """Collects triples while a file is read: one dict lookup per term, four bytes per id."""

    def __init__(self) -> None:
        # Provisional ids by name
        self.entities: dict[str, int] = defaultdict(count().__next__)
        self.relations: dict[str, int] = defaultdict(count().__next__)
        self.ids = array("i")  # head, relation and tail of every triple, flat
        # (rank of the language, text) by name
        self._labels: dict[str, tuple[int, str]] = {}
        self.confidence: dict[Triple, float] = {}  # of some triples
        self.prefixes: Mapping[str, str] = {}  # that the file declares

    def add(self, head: str, relation: str, tail: str) -> None:
        """Add one triple."""
        append = self.ids.append
        append(self.entities[head])
        append(self.relations[relation])
        append(self.entities[tail])

    def add_statement(self, head: str, relation: str, tail: str) -> None:
        """Add one triple of a file; a label statement becomes the label of its head.

        Of several labels of one name the English one is kept, then one without a language, then
        any; among equals the first in the alphabet.
        """
        text = parse_literal(tail) if relation in LABEL_RELATIONS else None
        if text is None:
            self.add(head, relation, tail)
            return
        rank = 2
        if text.language is None:
            rank = 1
        elif text.language.startswith("en"):
            rank = 0
        label = (rank, text.value)
        self._labels[head] = min(label, self._labels.get(head, label))

    def add_node(self, name: str) -> None:
        """Add an entity that may have no triple."""
        self.entities[name]  # the lookup numbers a new name

    def build(
        self, labels: _Labels | None = None, new_name: Callable[[str], str] = str
    ) -> KnowledgeGraph:
        """Sort and number the names and make the graph.

        Labels are those of the statements and the given ones, of names that are in the graph.
        ``new_name`` replaces every name of the statements; equal new names are one name.
        """
        entities, entity_ids = _sorted(map(new_name, self.entities))
        relations, relation_ids = _sorted(map(new_name, self.relations))
        triples = np.frombuffer(self.ids, np.int32).reshape(-1, 3).copy()
        triples[:, ::2] = entity_ids[triples[:, ::2]]
        triples[:, 1] = relation_ids[triples[:, 1]]
        texts = {}
        # Of names that become equal, the label of the lowest rank comes last and stays.
        ranked = sorted(self._labels.items(), key=itemgetter(1), reverse=True)
        for name, (_, text) in ranked:
            texts[new_name(name)] = text
        texts.update(labels or {})
        confidence = {}
        for (head, relation, tail), probability in self.confidence.items():
            if probability < 1:
                triple = (new_name(head), new_name(relation), new_name(tail))
                confidence[triple] = probability
        inside = texts.keys() & {*entities, *relations}
        return KnowledgeGraph(
            entities,
            relations,
            triples,
            nodes=np.arange(len(entities), dtype=np.int32),
            labels={name: texts[name] for name in sorted(inside)},
            confidence=confidence,
            prefixes=self.prefixes,
        )


def _sorted(names: Iterable[str]) -> tuple[Names, Ids]:
    """Sort names by provisional id; return them and the new id of each, (n,) int64."""
    provisional = list(names)
    different = Names(sorted(set(provisional)))
    for name in different:
        if "\0" in name:
            raise UserError(f"The name {name!r} contains a zero byte. Rename it.")
    ids = dict(zip(different, range(len(different)), strict=True))
    return different, np.array([ids[name] for name in provisional], np.int64)


def graph_of(
    triples: Iterable[Triple],
    *,
    nodes: Iterable[str] = (),
    labels: _Labels | None = None,
    confidence: Mapping[Triple, float] | None = None,
    prefixes: Mapping[str, str] | None = None,
) -> KnowledgeGraph:
    """Make a graph of triples of names, of entities that may have no triple, and of labels by name.

    ``confidence`` is the probability that a triple holds, of those that are not certain;
    ``prefixes`` are those of the graph's IRIs in SPARQL.

    >>> graph = graph_of([("mug", "hasColor", "red"), ("mug", "isA", "cup")])
    >>> list(graph)
    [('mug', 'hasColor', 'red'), ('mug', 'isA', 'cup')]
    """
    builder = GraphBuilder()
    builder.confidence = dict(confidence or {})
    builder.prefixes = prefixes or {}
    for triple in triples:
        builder.add(*triple)
    for node in nodes:
        builder.add_node(node)
    return builder.build(labels)


def with_triples(graph: KnowledgeGraph, triples: Iterable[Triple]) -> KnowledgeGraph:
    """Return a graph of other triples with the entities, labels and confidence of a graph.

    What follows from axioms among them is added.
    """
    changed = graph_of(
        triples,
        nodes=graph.entities,
        labels=graph.own_labels(),
        confidence=graph.stated().own_confidence(),
        prefixes=graph.prefixes,
    )
    return closed(changed.lacking(graph.missing)).graph


def with_facts(graph: KnowledgeGraph, triples: Iterable[Triple]) -> KnowledgeGraph:
    """Return a graph with more triples of its names and of new ones."""
    return with_triples(graph, (*graph.stated(), *triples))


def union(first: KnowledgeGraph, second: KnowledgeGraph) -> KnowledgeGraph:
    """Return what both graphs state as `merged`, and what follows from it."""
    return closed(merged(first, second)).graph


def merged(first: KnowledgeGraph, second: KnowledgeGraph) -> KnowledgeGraph:
    """Return what both state, and the entities of both.

    Labels and confidence of the first graph go first.
    Blank nodes of two graphs are never the same: those of the second get names that are free.
    """
    missing = dict.fromkeys((*first.missing, *second.missing))
    first = first.stated()
    second = second.stated()
    taken = set(first.entities)
    free = blank_names(taken.union(second.entities))
    new_names = dict(zip(second.entities, second.entities, strict=True))
    for name in second.entities:
        if name.startswith("_:") and name in taken:
            new_names[name] = next(free)

    def renamed(triple: Triple) -> Triple:
        head, relation, tail = triple
        return new_names[head], relation, new_names[tail]

    confidence = {}
    for triple, probability in second.own_confidence().items():
        if renamed(triple) not in first:
            confidence[renamed(triple)] = probability
    labels = {}
    for name, text in second.own_labels().items():
        labels[new_names.get(name, name)] = text
    both = graph_of(
        (*first, *map(renamed, second)),
        nodes=(*taken, *new_names.values()),
        labels=labels | first.own_labels(),
        confidence=confidence | first.own_confidence(),
        prefixes={**second.prefixes, **first.prefixes},
    )
    return both.lacking(tuple(missing))


def difference(first: KnowledgeGraph, second: KnowledgeGraph) -> KnowledgeGraph:
    """Return the triples of the first graph that the second lacks, with the entities they name.

    Of a graph with axioms these are stated triples, and what follows from them.
    """
    first = first.stated()
    excluded = set(second)
    kept = np.array([triple not in excluded for triple in first], bool)
    return closed(first.rows(kept)).graph


def shuffle_tails(graph: KnowledgeGraph, seed: int) -> KnowledgeGraph:
    """Permute the tails within each relation, so that counts stay and facts change.

    Triples that become equal are merged into one.
    """
    generator = np.random.default_rng(seed)
    triples = graph.triples
    for relation in np.unique(graph.relations):
        rows = np.flatnonzero(graph.relations == relation)
        triples[rows, 2] = graph.tails[generator.permutation(rows)]
    return graph.with_triples(triples)
