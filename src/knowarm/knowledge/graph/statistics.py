"""Graph statistics: sizes, hubs, cycles and ambiguous labels."""

from collections import Counter, defaultdict
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
    degree = np.bincount(graph.heads, minlength=size) + np.bincount(
        graph.tails, minlength=size
    )
    node_degree = degree[graph.nodes]
    hubs = graph.nodes[np.argsort(-node_degree, kind="stable")][:MOST]
    component = _components(graph.heads, graph.tails, size, "weak")
    relations = Counter(np.sort(graph.relations).tolist())  # of equal counts by number
    names_by_label: dict[str, list[str]] = defaultdict(list)
    if graph.labels:
        for name in graph.entities:
            names_by_label[label_of(name, graph.labels)].append(local_name(name))
    shared = dict[str, tuple[str, ...]]()
    for label, names in sorted(names_by_label.items()):
        if len(names) > 1 and len(shared) < MOST:
            shared[label] = tuple(names)
    by_relation = dict[str, int]()
    for relation, count in relations.most_common():
        by_relation[graph.relation_names[relation]] = count
    return GraphStatistics(
        triples=len(graph),
        entities=len(graph.nodes),
        relations=len(relations),
        labelled=len(graph.own_labels().keys() & graph.names),
        alone=int((node_degree == 0).sum()),
        components=len(np.unique(component[graph.nodes])),
        max_degree=int(node_degree.max(initial=0)),
        hubs=tuple((graph.names[node], int(degree[node])) for node in hubs),
        by_relation=by_relation,
        cycles=_cycles(graph),
        same_labels=shared,
    )


def _components(
    heads: np.ndarray, tails: np.ndarray, size: int, kind: str
) -> np.ndarray:
    """Return the number of each entity's component, (size,); `kind` is "weak" or "strong"."""
    edges = csr_matrix((np.ones(len(heads), bool), (heads, tails)), (size, size))
    return np.asarray(connected_components(edges, connection=kind)[1])


def _cycles(graph: KnowledgeGraph) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Find entities that reach each other along a relation that is not mostly symmetric."""
    size = len(graph.names)
    cycles = list[tuple[str, tuple[str, ...]]]()
    for relation in np.unique(graph.relations):
        rows = graph.relations == relation
        heads = graph.heads[rows].astype(np.int64)
        tails = graph.tails[rows].astype(np.int64)
        reverse = np.isin(tails * size + heads, heads * size + tails)
        if reverse.mean() > 0.5 and len(heads) > 2:
            continue
        component = _components(heads, tails, size, "strong")
        several = np.flatnonzero(np.bincount(component) > 1)[:MOST]
        groups = [np.flatnonzero(component == number) for number in several]
        groups.extend(
            np.unique(heads[heads == tails])[:MOST, None]
        )  # entities that reach themselves
        for group in groups:
            names = tuple(graph.names[node] for node in group[:8])
            cycles.append((graph.relation_names[relation], names))
    return tuple(cycles[:MOST])
