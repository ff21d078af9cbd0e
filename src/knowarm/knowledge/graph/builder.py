"""Construction of graphs from triples of names, and union and difference of graphs."""

from array import array
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from itertools import count

import numpy as np

from knowarm.errors import UserError
from knowarm.knowledge.graph.graph import KnowledgeGraph, Names, Triple
from knowarm.knowledge.graph.terms import LABEL_RELATIONS, blank_names, parse_literal


class GraphBuilder:
    """Collects triples while a file is read: one dict lookup per term, four bytes per id."""

    def __init__(self) -> None:
        self.entities: dict[str, int] = defaultdict(count().__next__)  # provisional id by name
        self.relations: dict[str, int] = defaultdict(count().__next__)
        self.ids = array("i")  # head, relation and tail of every triple, flat
        self._labels: dict[str, tuple[int, str]] = {}  # (rank of the language, text) by name
        self.confidence: dict[Triple, float] = {}  # of some triples

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
        rank = 1 if text.language is None else 0 if text.language.startswith("en") else 2
        label = (rank, text.value)
        self._labels[head] = min(label, self._labels.get(head, label))

    def add_node(self, name: str) -> None:
        """Add an entity that may have no triple."""
        self.entities[name]  # the lookup numbers a new name

    def rename(self, new_name: Callable[[str], str]) -> None:
        """Replace every name, after all triples were added; equal new names are one name."""
        ids = np.frombuffer(self.ids, np.int32).reshape(-1, 3)
        renamed = []
        for old, columns in ((self.entities, [0, 2]), (self.relations, [1])):
            new: dict[str, int] = defaultdict(count().__next__)
            new_ids = np.array([new[new_name(name)] for name in old], np.int32)
            ids[:, columns] = new_ids[ids[:, columns]]
            renamed.append(new)
        self.entities, self.relations = renamed
        labels = sorted(self._labels.items(), key=lambda item: item[1], reverse=True)
        self._labels = {new_name(name): label for name, label in labels}

    def build(self, labels: Mapping[str, str] | None = None) -> KnowledgeGraph:
        """Sort and number the names and make the graph.

        Labels are those of the statements and the given ones, of names that are in the graph.
        """
        entity_names, entity_rank = _sorted(self.entities)
        relation_names, relation_rank = _sorted(self.relations)
        triples = np.frombuffer(self.ids, np.int32).reshape(-1, 3).copy()
        for column, rank in enumerate((entity_rank, relation_rank, entity_rank)):
            triples[:, column] = rank[triples[:, column]]
        written = {name: text for name, (_, text) in self._labels.items()} | dict(labels or {})
        inside = sorted(written.keys() & (self.entities.keys() | self.relations.keys()))
        kept = {name: written[name] for name in inside}
        nodes = np.arange(len(self.entities), dtype=np.int32)
        doubtful = {triple: sure for triple, sure in self.confidence.items() if sure < 1}
        names = entity_names, relation_names
        return KnowledgeGraph(*names, triples, nodes=nodes, labels=kept, confidence=doubtful)


def _sorted(ids: dict[str, int]) -> tuple[Names, np.ndarray]:
    """Sort names; return them and the new id of each provisional id, (n,) int32."""
    names = Names(sorted(ids))
    if bad := next((name for name in names if "\0" in name), None):
        raise UserError(f"The name {bad!r} contains a zero byte. Rename it.")
    rank = np.empty(len(names), np.int32)
    rank[[ids[name] for name in names]] = np.arange(len(names))
    return names, rank


def graph_of(
    triples: Iterable[Triple],
    *,
    nodes: Iterable[str] = (),
    labels: Mapping[str, str] | None = None,
    confidence: Mapping[Triple, float] | None = None,
) -> KnowledgeGraph:
    """Make a graph of triples of names, of entities that may have no triple, and of labels by name.

    ``confidence`` is the probability that a triple holds, of those that are not certain.

    >>> graph = graph_of([("mug", "hasColor", "red"), ("mug", "isA", "cup")])
    >>> list(graph)
    [('mug', 'hasColor', 'red'), ('mug', 'isA', 'cup')]
    """
    builder = GraphBuilder()
    builder.confidence = dict(confidence or {})
    for triple in triples:
        builder.add(*triple)
    for node in nodes:
        builder.add_node(node)
    return builder.build(labels)


def with_facts(graph: KnowledgeGraph, triples: Iterable[Triple]) -> KnowledgeGraph:
    """Return a graph with more triples of its names and of new ones."""
    return graph_of((*graph, *triples), **graph.beside())


def union(first: KnowledgeGraph, second: KnowledgeGraph) -> KnowledgeGraph:
    """Return the triples and entities of both; labels and confidence of the first graph go first.

    Blank nodes of two graphs are never the same: those of the second get names that are free.
    """
    first_names = set(first.entities)
    free = blank_names(first_names.union(second.entities))
    new = {n: next(free) for n in second.entities if n.startswith("_:") and n in first_names}
    triples = ((new.get(h, h), r, new.get(t, t)) for h, r, t in second)
    nodes = (*first_names, *(new.get(name, name) for name in second.entities))
    labels = {new.get(name, name): label for name, label in second.own_labels().items()}
    doubted = second.own_confidence().items()
    sure = {(new.get(h, h), r, new.get(t, t)): each for (h, r, t), each in doubted}
    sure = {fact: each for fact, each in sure.items() if fact not in first} | {**first.confidence}
    labels |= first.own_labels()
    return graph_of((*first, *triples), nodes=nodes, labels=labels, confidence=sure)


def difference(first: KnowledgeGraph, second: KnowledgeGraph) -> KnowledgeGraph:
    """Return the triples of the first graph that the second lacks, with the entities they name."""
    excluded = set(second)
    keep = [row for row, triple in enumerate(first) if triple not in excluded]
    return first.rows(np.array(keep, np.int64))


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
