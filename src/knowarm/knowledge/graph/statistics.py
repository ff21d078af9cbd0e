"""Graph statistics: sizes, hubs, cycles and ambiguous labels."""

from collections import Counter, defaultdict
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from knowarm.knowledge.graph.graph import Ids, KnowledgeGraph
from knowarm.knowledge.graph.terms import label_of, local_name

MOST = 10
"""Most hubs, cycles and shared labels that are listed."""


_Cycle = tuple[str, tuple[str, ...]]
"""A relation, and entities that reach each other along it."""


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
    cycles: tuple[_Cycle, ...]
    """(relation, entities) that reach each other along one relation: a mistake in a hierarchy."""
    same_labels: dict[str, tuple[str, ...]]
    """Entities that share a label, by label."""


def graph_statistics(graph: KnowledgeGraph) -> GraphStatistics:
    """Compute the statistics of a graph."""
    nodes = graph.nodes
    ends = np.concatenate([graph.heads, graph.tails])
    degree = np.bincount(ends, minlength=len(graph.names))[nodes]
    hubs = np.argsort(-degree, kind="stable")[:MOST]
    component = _components(graph, graph.heads, graph.tails, "weak")
    by_relation = Counter(graph.relation_names.at(np.sort(graph.relations)))
    names_by_label: dict[str, list[str]] = defaultdict(list)
    if graph.labels:
        for name in graph.entities:
            names_by_label[label_of(name, graph.labels)].append(local_name(name))
    shared = []
    for label, names in sorted(names_by_label.items()):
        if len(names) > 1:
            shared.append((label, tuple(names)))
    return GraphStatistics(
        triples=len(graph),
        entities=len(nodes),
        relations=len(by_relation),
        labelled=len(graph.own_labels().keys() & graph.names),
        alone=int((degree == 0).sum()),
        components=len(np.unique(component[nodes])),
        max_degree=int(degree.max(initial=0)),
        hubs=tuple(
            zip(graph.names.at(nodes[hubs]), degree[hubs].tolist(), strict=True)
        ),
        by_relation=dict(by_relation.most_common()),
        cycles=_cycles(graph),
        same_labels=dict(shared[:MOST]),
    )


def _components(graph: KnowledgeGraph, heads: Ids, tails: Ids, kind: str) -> Ids:
    """Return the number of each entity's component, (E,); `kind` is "weak" or "strong"."""
    size = len(graph.names)
    edges = csr_matrix((np.ones(len(heads), bool), (heads, tails)), (size, size))
    return np.asarray(connected_components(edges, connection=kind)[1])


def _cycles(graph: KnowledgeGraph) -> tuple[_Cycle, ...]:
    """Find entities that reach each other along a relation that is not mostly symmetric."""
    size = len(graph.names)
    triples = graph.triples
    cycles = []
    for relation in np.unique(graph.relations):
        edges = triples[graph.relations == relation]
        heads, _, tails = edges.T
        reverse = np.isin(tails * size + heads, heads * size + tails)
        if reverse.mean() > 0.5 and len(edges) > 2:
            continue
        component = _components(graph, heads, tails, "strong")
        several = np.flatnonzero(np.bincount(component) > 1)[:MOST]
        groups = [np.flatnonzero(component == number) for number in several]
        to_itself = np.unique(heads[heads == tails])
        groups.extend(to_itself[:MOST, None])
        for group in groups:
            names = graph.names.at(group[:8])
            cycles.append((graph.relation_names[relation], tuple(names)))
    return tuple(cycles[:MOST])
