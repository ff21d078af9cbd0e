"""Knowledge graph: triples as sorted integer arrays with fast neighbour lookup, and gamma."""

import copy
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from itertools import chain
from typing import Literal, get_args

import numpy as np

from knowarm.arrays import Floats
from knowarm.errors import UserError, unknown_name
from knowarm.knowledge.graph.derivations import Derivations
from knowarm.knowledge.graph.names import Names, Spellings
from knowarm.knowledge.graph.terms import (
    LABEL_RELATIONS,
    is_denied_by_namespace,
    literal,
    local_name,
    name_key,
)
from knowarm.questions import SURE

Ids = np.ndarray
"""Ids of entities or relations, or numbers of triples."""
Triple = tuple[str, str, str]
"""(head, relation, tail), e.g. ("mug", "hasColor", "red")."""
Direction = Literal["out", "in", "both"]
_TYPES = {
    "type",
    "hastype",
    "rdftype",
    "instanceof",
    "isinstanceof",
    "class",
    "hasclass",
}
_SUBCLASSES = {"subclassof", "issubclassof"}
"""Names of relations to classes, as `name_key` spells them."""
_FEW = 20_000
"""With more entities than this, an error suggests names with the same first letter only."""
_NO_NODES = np.empty(0, np.int32)


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
        confidence: probability that a triple holds, 0 to 1, by triple of names; others are certain.
        prefixes: beginnings of IRIs by the prefixes that the file declares, "" for `:`.
        missing: names of the ontologies that the graph imports and that were not at hand.
        derivations: what was not stated, and what it follows from; None if all was stated.
    """

    def __init__(
        self,
        names: Names,
        relation_names: Names,
        triples: Ids,
        *,
        nodes: Ids = _NO_NODES,
        labels: Mapping[str, str] | None = None,
        confidence: Mapping[Triple, float] | None = None,
        prefixes: Mapping[str, str] | None = None,
        missing: tuple[str, ...] = (),
    ) -> None:
        """Make a graph of ids (n, 3) int: head, relation, tail, in any order.

        Duplicates are merged; ``nodes`` (m,) int32 are ids of entities that may have no triple.
        """
        heads, relations, tails = triples.T.astype(np.int64)
        keys = (heads * len(relation_names) + relations) * len(names) + tails
        _, rows = np.unique(keys, return_index=True)
        columns = np.ascontiguousarray(triples[rows].T.astype(np.int32))
        self.names = names
        self.relation_names = relation_names
        self.heads, self.relations, self.tails = columns
        self._alone = nodes
        self.labels: Mapping[str, str] = labels or {}
        self.confidence: Mapping[Triple, float] = confidence or {}
        self.prefixes: Mapping[str, str] = prefixes or {}
        self.missing = missing
        self.derivations: Derivations | None = None
        self.entity_spellings = Spellings(names, self.labels)
        self.relation_spellings = Spellings(relation_names, self.labels)

    @property
    def triples(self) -> Ids:
        """Ids of head, relation and tail of each triple, (n, 3) int64, sorted."""
        columns = [self.heads, self.relations, self.tails]
        return np.stack(columns, axis=1, dtype=np.int64)

    @cached_property
    def nodes(self) -> Ids:
        """The ids of the entities in this graph, (m,) int32, sorted."""
        is_node = np.zeros(len(self.names), bool)
        for ids in (self.heads, self.tails, self._alone):
            is_node[ids] = True
        return np.flatnonzero(is_node).astype(np.int32)

    @cached_property
    def type_relations(self) -> list[int]:
        """The ids of the relations that lead from an individual to its class."""
        return self._relations_called(_TYPES)

    @cached_property
    def is_a_relations(self) -> list[int]:
        """The ids of the relations that lead to a class from an individual, or a class below."""
        return self._relations_called({"isa"})

    @cached_property
    def subclass_relations(self) -> list[int]:
        """The ids of the relations that lead from a class to the one above it."""
        return self._relations_called(_SUBCLASSES)

    @cached_property
    def by_tail(self) -> Ids:
        """Rows in the order of their tails, (n,) int32."""
        return np.argsort(self.tails, kind="stable").astype(np.int32)

    @cached_property
    def tails_sorted(self) -> Ids:
        """Tails in the order of `by_tail`, (n,) int32."""
        return self.tails[self.by_tail]

    @cached_property
    def best_described(self) -> dict[str, tuple[int, ...]]:
        """What `homonyms.best_described` has found, by the name."""
        return {}

    def __len__(self) -> int:
        return len(self.heads)

    def __iter__(self) -> Iterator[Triple]:
        """Yield (head, relation, tail) names, sorted."""
        entity = self.names
        relation = self.relation_names
        for h, r, t in zip(self.heads, self.relations, self.tails, strict=True):
            yield entity[h], relation[r], entity[t]

    def __contains__(self, triple: Triple) -> bool:
        for head, relation, tail in self._ids(triple):
            rows = self.out_rows(head)
            is_it = (self.relations[rows] == relation) & (self.tails[rows] == tail)
            return bool(is_it.any())
        return False

    def _ids(self, triple: Triple) -> Iterator[tuple[int, int, int]]:
        """Yield the ids of a triple, if all of its names are known."""
        head = self.names.find(triple[0])
        relation = self.relation_names.find(triple[1])
        tail = self.names.find(triple[2])
        if head is not None and relation is not None and tail is not None:
            yield head, relation, tail

    def named(self, ids: Sequence[int] | Ids) -> Triple:
        """Return the names of a triple by its ids."""
        head, relation, tail = ids
        return self.names[head], self.relation_names[relation], self.names[tail]

    def __eq__(self, other: object) -> bool:
        """Return whether both graphs hold the same by name: triples, confidence, nodes, labels."""
        if not isinstance(other, KnowledgeGraph):
            return NotImplemented
        return (
            set(self) == set(other)
            and set(self.entities) == set(other.entities)
            and self.own_confidence() == other.own_confidence()
            and self.own_labels() == other.own_labels()
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
        return self.names.at(self.nodes)

    @property
    def relations_used(self) -> list[str]:
        """The names of the relations in this graph, sorted."""
        return self.relation_names.at(np.unique(self.relations))

    def own_labels(self) -> dict[str, str]:
        """Return the labels of the entities and relations of this graph."""
        inside = {*self.entities, *self.relations_used}
        return {name: label for name, label in self.labels.items() if name in inside}

    def label_statements(self) -> Iterator[Triple]:
        """Yield a triple per label: the name, rdfs:label and a literal; sorted by name."""
        for name, label in sorted(self.own_labels().items()):
            yield name, LABEL_RELATIONS[0], literal(label)

    def own_confidence(self) -> dict[Triple, float]:
        """Return the confidence of those triples of this graph that are not certain."""
        return {
            triple: share for triple, share in self.confidence.items() if triple in self
        }

    def because(self, triple: Triple) -> tuple[Triple, ...]:
        """Return the triples from which a derived one follows in one step; none of a stated one."""
        if self.derivations is None:
            return ()
        for ids in self._ids(triple):
            return tuple(map(self.named, self.derivations.because(ids)))
        return ()

    def grounds(self, triple: Triple) -> tuple[Triple, ...]:
        """Return the triples from which one follows in the end, in the order of reading.

        They are stated, or what an anonymous class says ("mug usedFor drinking").
        """
        grounds = dict[Triple, None]()
        waiting = [triple]
        while waiting:
            ground = waiting.pop()
            reasons = self.because(ground)
            if all(_is_anonymous(reason) for reason in reasons):
                grounds[ground] = None
            else:
                waiting += reversed(reasons)
        named = [ground for ground in grounds if not _is_anonymous(ground)]
        return tuple(named or grounds)

    def stated(self) -> "KnowledgeGraph":
        """Return the graph without what was derived."""
        if self.derivations is None:
            return self
        is_derived = self.derivations.is_derived(self.triples)
        graph = self.rows(~is_derived, nodes=self.nodes)
        graph.derivations = None
        return graph

    def lacking(self, missing: tuple[str, ...]) -> "KnowledgeGraph":
        """Return the same graph, which imports ontologies that are not at hand."""
        graph = copy.copy(self)
        graph.missing = missing
        return graph

    def out_rows(self, entity: int) -> Ids:
        """Return the rows whose head is the entity id, (k,) int64."""
        return np.arange(*_range(self.heads, entity))

    def in_rows(self, entity: int) -> Ids:
        """Return the rows whose tail is the entity id, (k,) int32."""
        low, high = _range(self.tails_sorted, entity)
        return self.by_tail[low:high]

    def probabilities(self, rows: Ids) -> Floats:
        """Return the probability that the triple of each row holds, (k,) float64."""
        shares = np.ones(len(rows))
        if self.confidence:
            shares[:] = [self.confidence.get(triple, 1) for triple in self.rows(rows)]
        return shares

    def believed(self, rows: Ids) -> Ids:
        """Return those rows whose triples are as probable as not, (k,)."""
        return rows[self.probabilities(rows) >= SURE]

    def linking(self, rows: Ids, relations: Sequence[int]) -> Ids:
        """Return those rows whose triples have one of some relations and are believed, (k,)."""
        if not relations or not len(rows):
            return rows[:0]
        return self.believed(rows[np.isin(self.relations[rows], relations)])

    def rows(self, rows: Ids, nodes: Ids = _NO_NODES) -> "KnowledgeGraph":
        """Return the triples of rows, (k,) int ascending or (n,) bool, and nodes (m,) without."""
        subgraph = copy.copy(self)
        for cached in ("nodes", "by_tail", "tails_sorted", "best_described"):
            subgraph.__dict__.pop(cached, None)
        subgraph.heads = self.heads[rows]
        subgraph.relations = self.relations[rows]
        subgraph.tails = self.tails[rows]
        subgraph._alone = nodes
        return subgraph

    def with_triples(
        self, triples: Ids, relation_names: Names | None = None
    ) -> "KnowledgeGraph":
        """Return a graph with the entities, names and labels of this one and other triples."""
        return KnowledgeGraph(
            self.names,
            relation_names or self.relation_names,
            triples,
            nodes=self.nodes,
            labels=self.labels,
            confidence=self.confidence,
            prefixes=self.prefixes,
            missing=self.missing,
        )

    def find_entity(self, name: str) -> int | None:
        """Return the id by name, last part of the IRI, label or spelling; None without.

        Raises:
            AmbiguousNameError: several are found alike.
        """
        return self.entity_spellings.find(name, "entities", self.has_node)

    def entity_id(self, name: str) -> int:
        """Return the id as `find_entity`; raise a `UserError` without."""
        entity = self.find_entity(name)
        if entity is not None:
            return entity
        names = {local_name(n) for n in self.entities if not n.startswith('"')}
        if len(names) > _FEW:
            names = {
                n for n in names if n[:1] == name[:1] and abs(len(n) - len(name)) < 3
            }
        raise unknown_name("entity", name, names)

    def values(self, name: str) -> list[int]:
        """Return the ids of what a value names: an entity, and all literals of this text."""
        ids = list(filter(self.has_node, self.names.find_literals(name)))
        entity = self.find_entity(name)
        if entity is not None and entity not in ids:
            ids.insert(0, entity)
        return ids

    def alike(self, name: str) -> list[int]:
        """Return the ids of all entities and literals that a name may stand for."""
        ids = set(chain.from_iterable(self.entity_spellings.alike(name)))
        ids.update(self.names.find_literals(name))
        return sorted(filter(self.has_node, ids))

    def find_relation(self, name: str) -> int | None:
        """Return the id as `find_entity`; one that its namespace denies by its whole name only."""

        def counts(relation: int) -> bool:
            whole = self.relation_names[relation]
            return whole == name or not is_denied_by_namespace(whole)

        return self.relation_spellings.find(name, "relations", counts)

    def relation_id(self, name: str) -> int:
        """Return the id as `find_relation`; raise a `UserError` without."""
        relation = self.find_relation(name)
        if relation is not None:
            return relation
        raise unknown_name("relation", name, map(local_name, self.relation_names))

    def _relations_called(self, keys: Collection[str]) -> list[int]:
        ids = []
        for relation, name in enumerate(self.relation_names):
            words = {name_key(local_name(name)), name_key(self.labels.get(name, name))}
            if not words.isdisjoint(keys):
                ids.append(relation)
        return ids

    def has_node(self, entity: int) -> bool:
        """Return whether an entity id is in this graph."""
        low, high = _range(self.nodes, entity)
        return low < high


def _is_anonymous(triple: Triple) -> bool:
    return triple[0].startswith("_:") or triple[2].startswith("_:")


def _range(ids: Ids, wanted: int) -> tuple[int, int]:
    """Return where an id begins and ends in ids that are sorted, (n,) int32."""
    low, high = np.searchsorted(ids, np.array([wanted, wanted + 1], np.int32))
    return low, high


def gamma(
    graph: KnowledgeGraph,
    entities: Sequence[str],
    *,
    hops: int = 1,
    direction: Direction = "out",
    relations: Iterable[str] | None = None,
    max_degree: int | None = None,
) -> KnowledgeGraph:
    """Select entities by name and all entities at most `hops` edges from them: Gamma(G, O).

    The paper (section 4.1): "all the nodes representing the objects that the agent is perceiving
    and the nodes at distance 1 from them", and the edges between the two. The direction "out"
    follows the edges whose head is the object; ``relations`` None follows all; an entity with more
    edges than ``max_degree`` in that direction is not expanded, unless it was selected by name.

    Further hops keep their direction: `mug -> red` may continue to `red -> color` and never returns
    through `red <- fire_truck`, so that an attribute that many objects share stays a leaf.
    """
    for option, number in {"hops": hops, "max_degree": max_degree or 0}.items():
        if number < 0:
            raise UserError(f"{option} is {number}; it must be 0 or more.")
    if direction not in get_args(Direction):
        raise unknown_name("direction", direction, get_args(Direction))
    start = np.unique(np.array(list(map(graph.entity_id, entities)), np.int32))
    allowed = None
    if relations is not None:
        allowed = list(map(graph.relation_id, relations))
    # The edges of an entity, and what is at their other ends
    sides = []
    if direction != "in":
        sides.append((graph.out_rows, graph.tails))
    if direction != "out":
        sides.append((graph.in_rows, graph.heads))
    rows = [np.empty(0, np.int64)]
    for edges_of, ends in sides:
        seen = frontier = start
        for hop in range(hops):
            if not len(frontier):
                break
            reached = [_NO_NODES]
            for entity in frontier:
                edges = edges_of(entity)
                if hop and max_degree is not None and len(edges) > max_degree:
                    continue
                if allowed is not None:
                    edges = edges[np.isin(graph.relations[edges], allowed)]
                rows.append(edges)
                reached.append(ends[edges])
            frontier = np.setdiff1d(np.concatenate(reached), seen)
            seen = np.union1d(seen, frontier)
    return graph.rows(np.unique(np.concatenate(rows)), nodes=start)
