"""Oxigraph stores of graphs: made at the first SPARQL query of a graph, and kept with it."""

import os
import weakref
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import product, starmap
from threading import RLock

import numpy as np
from pyoxigraph import Quad, Store

from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.terms import (
    iri_term,
    node_term,
    object_term,
    triple_of_names,
)


@contextmanager
def stating(
    store: Store, head: str, relations: Iterable[str], tails: Iterable[str]
) -> Iterator[None]:
    """State, in a ``with`` block, that relations lead from a head to these tails alone.

    Other threads wait for the end of the block, which restores the triples of the graph.
    """
    new = list(starmap(_quad, product([head], relations, tails)))
    with LOCK:
        old = set[Quad]()
        for quad in new:
            old.update(store.quads_for_pattern(quad.subject, quad.predicate, None))
        try:
            _replace(store, old, new)
            yield
        finally:
            _replace(store, new, old)


def _replace(store: Store, old: Iterable[Quad], new: Iterable[Quad]) -> None:
    for quad in old:
        store.remove(quad)
    store.extend(new)


LOCK = RLock()
"""Held while a store is made, read or changed, since threads and forked processes share it."""
if hasattr(os, "register_at_fork"):
    os.register_at_fork(
        before=LOCK.acquire,
        after_in_parent=LOCK.release,
        after_in_child=LOCK.release,
    )
_STORES: dict[int, Store] = {}
"""Stores by the identity of their graph, while it exists."""


def store_of(graph: KnowledgeGraph) -> Store:
    """Return the store of the triples and labels of a graph, which is made once."""
    key = id(graph)
    with LOCK:
        if key not in _STORES:
            store = _STORES[key] = Store()
            store.bulk_extend(_quads(graph))
            store.bulk_extend(starmap(_quad, graph.label_statements()))
            weakref.finalize(graph, _STORES.pop, key)
        return _STORES[key]


def _quads(graph: KnowledgeGraph) -> Iterator[Quad]:
    """Make the triples of a graph, and each term once: that is what costs most."""
    subjects = {}
    for head in np.unique(graph.heads).tolist():
        subjects[head] = node_term(graph.names[head])
    objects = {}
    for tail in np.unique(graph.tails).tolist():
        objects[tail] = object_term(graph.names[tail])
    predicates = list(map(iri_term, graph.relation_names))
    return map(
        Quad,
        map(subjects.__getitem__, graph.heads.tolist()),
        map(predicates.__getitem__, graph.relations.tolist()),
        map(objects.__getitem__, graph.tails.tolist()),
    )


def _quad(head: str, relation: str, tail: str) -> Quad:
    triple = triple_of_names(head, relation, tail)
    return Quad(triple.subject, triple.predicate, triple.object)
