"""Knowledge graph: a set of triples as sorted integer arrays with fast neighbour lookup."""

from collections.abc import Iterator, Mapping
from functools import cached_property

import numpy as np

from knowarm.errors import UserError, unknown_name
from knowarm.knowledge.names import Names
from knowarm.knowledge.terms import local_name

Triple = tuple[str, str, str]
"""(head, relation, tail), e.g. ("mug", "hasColor", "red")."""

_FEW = 20_000
"""With more entities than this, an error suggests names with the same first letter only."""


class KnowledgeGraph:
    """A set of triples over names, held as sorted integers.

    Entities and relations are numbered in the order of their names. Triples are sorted by (head,
    relation, tail), with a second order by tail, so that the edges of an entity are one slice in
    either direction. A triple takes about 20 bytes. A graph is immutable.

    A subgraph shares its parent's names, so that it costs only its own edges.

    Attributes:
        names: entity names by id.
        relation_names: relation names by id.
        heads, relations, tails: ids, each (n,) int32, sorted by (head, relation, tail), distinct.
        labels: written label (rdfs:label) by entity or relation name.
    """

    def __init__(
        self,
        names: Names,
        relation_names: Names,
        triples: np.ndarray,
        *,
        nodes: np.ndarray | None = None,
        labels: Mapping[str, str] | None = None,
    ) -> None:
        """Make a graph.

        Args:
            names: entity names by id.
            relation_names: relation names by id.
            triples: ids (n, 3) int: head, relation, tail, in any order; duplicates are merged.
            nodes: ids of entities that may have no triple, (m,) int32.
            labels: written labels by name.
        """
        order = np.lexsort((triples[:, 2], triples[:, 1], triples[:, 0]))
        triples = triples[order].astype(np.int32, copy=False)
        if len(triples):
            new = np.ones(len(triples), bool)
            np.any(triples[1:] != triples[:-1], axis=1, out=new[1:])
            triples = triples if new.all() else triples[new]
        self.names, self.relation_names = names, relation_names
        self.heads, self.relations, self.tails = (
            np.ascontiguousarray(triples[:, i]) for i in range(3)
        )
        self._alone = np.empty(0, np.int32) if nodes is None else nodes
        self.labels: Mapping[str, str] = {} if labels is None else labels

    @cached_property
    def nodes(self) -> np.ndarray:
        """The ids of the entities in this graph, (m,) int32, sorted."""
        return np.unique(np.concatenate([self.heads, self.tails, self._alone])).astype(np.int32)

    @cached_property
    def by_tail(self) -> np.ndarray:
        """Rows in the order of their tails, (n,) int32."""
        return np.argsort(self.tails, kind="stable").astype(np.int32)

    @cached_property
    def tails_sorted(self) -> np.ndarray:
        """Tails in the order of `by_tail`, (n,) int32."""
        return self.tails[self.by_tail]

    # ------------------------------------------------------------------ reading

    def __len__(self) -> int:
        return len(self.heads)

    def __iter__(self) -> Iterator[Triple]:
        """Yield (head, relation, tail) names, sorted."""
        entity, relation = self.names, self.relation_names
        for h, r, t in zip(self.heads, self.relations, self.tails, strict=True):
            yield entity[h], relation[r], entity[t]

    def __contains__(self, triple: Triple) -> bool:
        head, tail = self.names.find(triple[0]), self.names.find(triple[2])
        relation = self.relation_names.find(triple[1])
        if head is None or tail is None or relation is None:
            return False
        rows = self.out_rows(head)
        return bool(((self.relations[rows] == relation) & (self.tails[rows] == tail)).any())

    def __eq__(self, other: object) -> bool:
        """Return whether both graphs hold the same triples, entities and labels by name."""
        if not isinstance(other, KnowledgeGraph):
            return NotImplemented
        if len(self) != len(other) or len(self.nodes) != len(other.nodes):
            return False
        return (
            set(self) == set(other)
            and set(self.entities) == set(other.entities)
            and (self.own_labels() == other.own_labels())
        )

    __hash__ = None  # type: ignore[assignment]  # equality compares every triple

    def __repr__(self) -> str:
        return (
            f"KnowledgeGraph({len(self):,} triples, {len(self.nodes):,} entities, "
            f"{len(self.relations_used):,} relations)"
        )

    @property
    def entities(self) -> list[str]:
        """The names of the entities in this graph, sorted."""
        if len(self.nodes) == len(self.names):
            return list(self.names)
        return [self.names[i] for i in self.nodes]

    @property
    def relations_used(self) -> list[str]:
        """The names of the relations in this graph, sorted."""
        return [self.relation_names[i] for i in np.unique(self.relations)]

    @property
    def nbytes(self) -> int:
        """Bytes held by triples and names."""
        arrays = (self.heads, self.relations, self.tails, self.by_tail, self.tails_sorted)
        names = sum(len(n.blob) + n.offsets.nbytes for n in (self.names, self.relation_names))
        return sum(a.nbytes for a in arrays) + self.nodes.nbytes + names

    def own_labels(self) -> dict[str, str]:
        """Return the labels of the entities and relations of this graph."""
        inside = {*self.entities, *self.relations_used} if self.labels else set()
        return {name: label for name, label in self.labels.items() if name in inside}

    # ------------------------------------------------------------------ edges

    def out_rows(self, entity: int) -> slice:
        """Return the rows whose head is the entity id."""
        low = np.searchsorted(self.heads, np.int32(entity))
        return slice(int(low), int(np.searchsorted(self.heads, np.int32(entity), side="right")))

    def in_rows(self, entity: int) -> np.ndarray:
        """Return the rows whose tail is the entity id, (k,) int32."""
        low = np.searchsorted(self.tails_sorted, np.int32(entity))
        high = np.searchsorted(self.tails_sorted, np.int32(entity), side="right")
        return self.by_tail[low:high]

    def rows(self, rows: np.ndarray, nodes: np.ndarray | None = None) -> "KnowledgeGraph":
        """Return a subgraph that shares the names.

        Args:
            rows: rows of the triples to keep, (k,) int, ascending.
            nodes: ids of entities that may have no triple, (m,) int32.
        """
        part = object.__new__(KnowledgeGraph)
        part.names, part.relation_names, part.labels = self.names, self.relation_names, self.labels
        part.heads, part.relations = self.heads[rows], self.relations[rows]
        part.tails = self.tails[rows]
        part._alone = np.empty(0, np.int32) if nodes is None else nodes
        return part

    # ------------------------------------------------------------------ names

    def entity_id(self, name: str) -> int:
        """Return the id of an entity given by name, last part of its IRI, or label.

        Raises:
            UserError: no entity of this graph has that name, or several have.
        """
        exact = self.names.find(name)
        if exact is not None and self._has_node(exact):
            return exact
        found = [i for i in self.names.find_local(name) if self._has_node(i)]
        if not found:
            labelled = (self.names.find(n) for n, label in self.labels.items() if label == name)
            found = [i for i in labelled if i is not None and self._has_node(i)]
        if len(found) == 1:
            return found[0]
        if found:
            full = ", ".join(sorted(self.names[i] for i in found)[:5])
            raise UserError(
                f"{name!r} names {len(found)} entities of the graph: {full}. "
                f"Give the full name of one of them."
            )
        names = {local_name(n) for n in self.entities}
        if len(names) > _FEW:
            names = {n for n in names if n[:1] == name[:1] and abs(len(n) - len(name)) < 3}
        raise unknown_name("entity", name, names)

    def relation_id(self, name: str) -> int:
        """Return the id of a relation given by name or the last part of its IRI."""
        exact = self.relation_names.find(name)
        found = self.relation_names.find_local(name) if exact is None else [exact]
        if len(found) == 1:
            return found[0]
        raise unknown_name("relation", name, [local_name(n) for n in self.relation_names])

    def _has_node(self, entity: int) -> bool:
        place = int(np.searchsorted(self.nodes, np.int32(entity)))
        return place < len(self.nodes) and self.nodes[place] == entity
