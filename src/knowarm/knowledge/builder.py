"""Triples of names go in one by one; a sorted KnowledgeGraph comes out."""

from array import array
from collections.abc import Iterable, Mapping

import numpy as np

from knowarm.knowledge.graph import KnowledgeGraph, Triple
from knowarm.knowledge.names import Names


class GraphBuilder:
    """Collects triples while a file is read: one dict lookup a term, four bytes an id.

    Attributes:
        entities, relations: provisional id by name, in the order of arrival.
        ids: head, relation, tail of every triple, flat.
    """

    def __init__(self) -> None:
        self.entities: dict[str, int] = {}
        self.relations: dict[str, int] = {}
        self.ids = array("i")

    def add(self, head: str, relation: str, tail: str) -> None:
        """Add one triple."""
        entities, relations = self.entities, self.relations
        self.ids.extend(
            (
                entities.setdefault(head, len(entities)),
                relations.setdefault(relation, len(relations)),
                entities.setdefault(tail, len(entities)),
            )
        )

    def add_node(self, name: str) -> None:
        """Add an entity that may have no triple."""
        self.entities.setdefault(name, len(self.entities))

    def add_graph(self, graph: KnowledgeGraph) -> None:
        """Add all triples and entities of a graph."""
        for head, relation, tail in graph:
            self.add(head, relation, tail)
        for name in graph.entities:
            self.add_node(name)

    def build(self, labels: Mapping[str, str]) -> KnowledgeGraph:
        """Number the names in their order and make the graph.

        Args:
            labels: written labels by name; those of names not in the graph are left out.
        """
        entity_names, entity_rank = _sorted(self.entities)
        relation_names, relation_rank = _sorted(self.relations)
        triples = np.frombuffer(self.ids, np.int32).reshape(-1, 3).copy()
        triples[:, 0] = entity_rank[triples[:, 0]]
        triples[:, 1] = relation_rank[triples[:, 1]]
        triples[:, 2] = entity_rank[triples[:, 2]]
        kept = {
            name: labels[name]
            for name in sorted(labels)
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
    """Make a graph of triples of names, and of entities that may have no triple."""
    builder = GraphBuilder()
    for head, relation, tail in triples:
        builder.add(head, relation, tail)
    for node in nodes:
        builder.add_node(node)
    return builder.build(labels or {})
