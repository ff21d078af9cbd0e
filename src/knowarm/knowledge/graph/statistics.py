"""Graph statistics: sizes, hubs, cycles and ambiguous labels."""

from collections import defaultdict
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.terms import label_of, local_name

MOST = 10
"""Most hubs, cycles and shared labels that are listed."""


class GraphStatistics(NamedTuple):
    """Counts of a graph, and properties that often are mistakes."""

    triples: int
    entities: int
    relations: int
    labelled: int
    """Entities with a written label."""
    alone: int
    """Entities without any triple."""
    components: int
    max_degree: int
    hubs: tuple[tuple[str, int], ...]
    """The entities with the most edges, and their degrees."""
    by_relation: dict[str, int]
    """Triples per relation, most frequent first."""
    cycles: tuple[tuple[str, tuple[str, ...]], ...]
    """(relation, entities) that reach each other along one relation: a mistake in a hierarchy."""
    same_labels: dict[str, tuple[str, ...]]
    """Entities that share a label, by label."""


def graph_statistics(graph: KnowledgeGraph) -> GraphStatistics:
    """Compute the statistics of a graph."""
    size = len(graph.names)
    degree = np.bincount(graph.heads, minlength=size) + np.bincount(graph.tails, minlength=size)
    node_degree = degree[graph.nodes]
    part = _components(graph.heads, graph.tails, size, "weak")
    order = graph.nodes[np.lexsort((graph.nodes, -node_degree))][:MOST]
    counts = np.bincount(graph.relations, minlength=len(graph.relation_names))
    used = sorted(np.flatnonzero(counts), key=lambda i: (-counts[i], i))
    owners: dict[str, list[str]] = defaultdict(list)
    for name in graph.entities if graph.labels else ():
        owners[label_of(name, graph.labels)].append(local_name(name))
    double = [(label, tuple(names)) for label, names in sorted(owners.items()) if len(names) > 1]
    return GraphStatistics(
        triples=len(graph),
        entities=len(graph.nodes),
        relations=len(used),
        labelled=sum(graph.names.find(name) is not None for name in graph.own_labels()),
        alone=int((node_degree == 0).sum()),
        components=len(np.unique(part[graph.nodes])),
        max_degree=int(node_degree.max(initial=0)),
        hubs=tuple((graph.names[int(i)], int(degree[i])) for i in order),
        by_relation={graph.relation_names[int(i)]: int(counts[i]) for i in used},
        cycles=_cycles(graph),
        same_labels=dict(double[:MOST]),
    )


def _components(heads: np.ndarray, tails: np.ndarray, size: int, kind: str) -> np.ndarray:
    """Return the number of each entity's component, (size,); `kind` is "weak" or "strong"."""
    edges = csr_matrix((np.ones(len(heads), bool), (heads, tails)), (size, size))
    return np.asarray(connected_components(edges, connection=kind)[1])


def _cycles(graph: KnowledgeGraph) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Find entities that reach each other along a relation that is not mostly symmetric."""
    size, cycles = len(graph.names), []
    for relation in np.unique(graph.relations):
        rows = graph.relations == relation
        heads, tails = graph.heads[rows].astype(np.int64), graph.tails[rows].astype(np.int64)
        reverse = np.isin(tails * size + heads, heads * size + tails)
        if reverse.mean() > 0.5 and len(heads) > 2:
            continue
        part = _components(heads, tails, size, "strong")
        groups = [np.flatnonzero(part == i) for i in np.flatnonzero(np.bincount(part) > 1)[:MOST]]
        groups += [np.array([node]) for node in np.unique(heads[heads == tails])[:MOST]]
        name = graph.relation_names[int(relation)]
        cycles += [(name, tuple(graph.names[i] for i in group[:8])) for group in groups]
    return tuple(cycles[:MOST])
