"""Construction of graphs from triples of names, and union and difference of graphs."""

from array import array
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from itertools import count

import numpy as np

from knowarm.knowledge.graph import KnowledgeGraph, Triple
from knowarm.knowledge.names import Names
from knowarm.knowledge.terms import LABEL_RELATIONS, parse_literal


class GraphBuilder:
    """Collects triples while a file is read: one dict lookup per term, four bytes per id.

    Attributes:
        entities: provisional id by name, in the order of arrival.
        relations: the same for relations.
        ids: head, relation and tail id of every triple, flat.
    """

    def __init__(self) -> None:
        self.entities: dict[str, int] = defaultdict(count().__next__)
        self.relations: dict[str, int] = defaultdict(count().__next__)
        self.ids = array("i")
        self._labels: dict[str, tuple[int, str]] = {}  # (rank of the language, text) by name

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
        language = text.language
        rank = 1 if language is None else 0 if language.startswith("en") else 2
        label = (rank, text.value)
        self._labels[head] = min(label, self._labels.get(head, label))

    def add_node(self, name: str) -> None:
        """Add an entity that may have no triple."""
        self.entities[name]  # the lookup numbers a new name

    def add_graph(self, graph: KnowledgeGraph) -> None:
        """Add all triples and entities of a graph, without its labels."""
        for head, relation, tail in graph:
            self.add(head, relation, tail)
        for name in graph.entities:
            self.add_node(name)

    def rename(self, new_name: Callable[[str], str]) -> None:
        """Replace every name, after all triples were added; different names stay different."""
        self.entities = {new_name(name): i for name, i in self.entities.items()}
        self.relations = {new_name(name): i for name, i in self.relations.items()}
        self._labels = {new_name(name): label for name, label in self._labels.items()}

    def build(self, labels: Mapping[str, str] | None = None) -> KnowledgeGraph:
        """Sort and number the names and make the graph.

        Args:
            labels: written labels by name, beside those of the added statements; labels of names
                that are not in the graph are dropped.
        """
        entity_names, entity_rank = _sorted(self.entities)
        relation_names, relation_rank = _sorted(self.relations)
        triples = np.frombuffer(self.ids, np.int32).reshape(-1, 3).copy()
        triples[:, 0] = entity_rank[triples[:, 0]]
        triples[:, 1] = relation_rank[triples[:, 1]]
        triples[:, 2] = entity_rank[triples[:, 2]]
        written = {name: text for name, (_, text) in self._labels.items()} | dict(labels or {})
        kept = {
            name: written[name]
            for name in sorted(written)
            if name in self.entities or name in self.relations
        }
        nodes = np.arange(len(self.entities), dtype=np.int32)
        return KnowledgeGraph(entity_names, relation_names, triples, nodes=nodes, labels=kept)


def _sorted(ids: dict[str, int]) -> tuple[Names, np.ndarray]:
    """Sort names; return them and the new id of each provisional id, (n,) int32."""
    names = sorted(ids)
    rank = np.empty(len(names), np.int32)
    for new, name in enumerate(names):
        rank[ids[name]] = new
    return Names.from_sorted(names), rank


def graph_of(
    triples: Iterable[Triple],
    *,
    nodes: Iterable[str] = (),
    labels: Mapping[str, str] | None = None,
) -> KnowledgeGraph:
    """Make a graph.

    Args:
        triples: (head, relation, tail) names in any order.
        nodes: entities that may have no triple.
        labels: written labels by name.

    Example:
        >>> graph = graph_of([("mug", "hasColor", "red"), ("mug", "isA", "cup")])
        >>> list(graph)
        [('mug', 'hasColor', 'red'), ('mug', 'isA', 'cup')]
    """
    builder = GraphBuilder()
    for head, relation, tail in triples:
        builder.add(head, relation, tail)
    for node in nodes:
        builder.add_node(node)
    return builder.build(labels)


def union(first: KnowledgeGraph, second: KnowledgeGraph) -> KnowledgeGraph:
    """Return the triples and entities of both; where labels differ, the first graph's are kept."""
    builder = GraphBuilder()
    for graph in (first, second):
        builder.add_graph(graph)
    return builder.build({**second.own_labels(), **first.own_labels()})


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
    tails = graph.tails.copy()
    for relation in np.unique(graph.relations):
        rows = np.flatnonzero(graph.relations == relation)
        tails[rows] = tails[generator.permutation(rows)]
    triples = np.stack([graph.heads, graph.relations, tails], axis=1)
    return KnowledgeGraph(
        graph.names, graph.relation_names, triples, nodes=graph.nodes, labels=graph.labels
    )
