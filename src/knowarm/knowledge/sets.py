"""Two graphs go in; their union or difference, a graph again, comes out."""

import numpy as np

from knowarm.knowledge.builder import GraphBuilder
from knowarm.knowledge.graph import KnowledgeGraph


def union(first: KnowledgeGraph, second: KnowledgeGraph) -> KnowledgeGraph:
    """Return the triples and entities of both; where labels differ, the first graph's stand."""
    builder = GraphBuilder()
    for graph in (first, second):
        builder.add_graph(graph)
    return builder.build({**second.own_labels(), **first.own_labels()})


def difference(first: KnowledgeGraph, second: KnowledgeGraph) -> KnowledgeGraph:
    """Return the triples of the first graph that the second lacks, with the entities they name."""
    gone = set(second)
    keep = [row for row, triple in enumerate(first) if triple not in gone]
    return first.rows(np.array(keep, np.int64))
