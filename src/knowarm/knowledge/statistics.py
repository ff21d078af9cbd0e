"""Graph statistics: sizes, hubs, cycles and ambiguous labels."""

from collections import defaultdict
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import scipy

from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.terms import label_of, local_name


@dataclass(frozen=True, kw_only=True)
class GraphStatistics:
    """Counts of a graph, and properties that often are mistakes."""

    triples: int
    entities: int
    relations: int
    labelled: int
    """Entities with a written label."""
    alone: int
    """Entities without any triple."""
    components: int
    """Connected components."""
    max_degree: int
    hubs: tuple[tuple[str, int], ...]
    """The entities with the most edges, and their degrees."""
    by_relation: dict[str, int]
    """Triples per relation, most frequent first."""
    cycles: tuple[tuple[str, tuple[str, ...]], ...]
    """(relation, entities) that reach each other along one relation: at most ten. In a hierarchy
    (isA) such a cycle is a mistake."""
    same_labels: dict[str, tuple[str, ...]]
    """Entities that share a label, by label: at most ten."""

    def describe(self) -> dict[str, Any]:
        """Return all fields as JSON-able values."""
        return asdict(self)


def graph_statistics(graph: KnowledgeGraph, hubs: int = 10) -> GraphStatistics:
    """Compute the statistics of a graph, with the `hubs` largest hubs."""
    size = len(graph.names)
    degree = np.bincount(graph.heads, minlength=size) + np.bincount(graph.tails, minlength=size)
    own = degree[graph.nodes]
    edges = scipy.sparse.csr_matrix(
        (np.ones(len(graph), bool), (graph.heads, graph.tails)), (size, size)
    )
    _, part = scipy.sparse.csgraph.connected_components(edges, directed=False)
    inside = len(np.unique(part[graph.nodes])) if size else 0
    order = graph.nodes[np.lexsort((graph.nodes, -own))][:hubs]
    counts = np.bincount(graph.relations, minlength=len(graph.relation_names))
    used = sorted(np.flatnonzero(counts), key=lambda i: (-counts[i], i))
    return GraphStatistics(
        triples=len(graph),
        entities=len(graph.nodes),
        relations=len(used),
        labelled=sum(graph.names.find(name) is not None for name in graph.own_labels()),
        alone=int((own == 0).sum()),
        components=inside,
        max_degree=int(own.max()) if len(own) else 0,
        hubs=tuple((graph.names[int(i)], int(degree[i])) for i in order),
        by_relation={graph.relation_names[int(i)]: int(counts[i]) for i in used},
        cycles=_cycles(graph),
        same_labels=_same_labels(graph),
    )


def _cycles(graph: KnowledgeGraph, most: int = 10) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Find groups of entities that reach each other along one relation.

    Relations in which most edges have their reverse are left out: a symmetric relation
    (isNextTo) forms such groups everywhere.
    """
    size, found = len(graph.names), []
    for relation in np.unique(graph.relations):
        rows = graph.relations == relation
        heads, tails = graph.heads[rows].astype(np.int64), graph.tails[rows].astype(np.int64)
        reverse = np.isin(tails * size + heads, heads * size + tails)
        if reverse.mean() > 0.5 and len(heads) > 2:
            continue
        edges = scipy.sparse.csr_matrix((np.ones(len(heads), bool), (heads, tails)), (size, size))
        _, part = scipy.sparse.csgraph.connected_components(
            edges, directed=True, connection="strong"
        )
        together = np.flatnonzero(np.bincount(part) > 1)
        groups = [np.flatnonzero(part == group) for group in together[:most]]
        groups += [np.array([node]) for node in np.unique(heads[heads == tails])[:most]]
        name = graph.relation_names[int(relation)]
        found += [(name, tuple(graph.names[i] for i in group[:8])) for group in groups]
    return tuple(found[:most])


def _same_labels(graph: KnowledgeGraph, most: int = 10) -> dict[str, tuple[str, ...]]:
    """Find labels that several entities share, as label or name."""
    if not graph.labels:
        return {}
    owners: dict[str, list[str]] = defaultdict(list)
    for name in graph.entities:
        owners[label_of(name, graph.labels)].append(local_name(name))
    double = {label: tuple(names) for label, names in sorted(owners.items()) if len(names) > 1}
    return dict(list(double.items())[:most])
