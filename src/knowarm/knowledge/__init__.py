"""Knowledge: from a graph of triples to the vector that a policy receives.

The steps are `read_graph`, `gamma` (the subgraph around the perceived objects), `sentence` (its
labels in order), a vector source (see `knowledge.vectors`) and `scene_embedding`.
"""

from knowarm.knowledge.config import FULL, FULL_PLUS, QUERY, KnowledgeConfig
from knowarm.knowledge.embedding import (
    Embedding,
    QueryEmbedding,
    SceneEmbedding,
    query_embedding,
    scene_embedding,
)
from knowarm.knowledge.formats import household, read_graph, write_graph
from knowarm.knowledge.graph.builder import graph_of
from knowarm.knowledge.graph.graph import KnowledgeGraph, gamma
from knowarm.knowledge.slots import scene_sentences, scene_subgraph, sentence
from knowarm.knowledge.vectors import SOURCES
from knowarm.knowledge.vectors.source import Facet

__all__ = [
    "FULL",
    "FULL_PLUS",
    "QUERY",
    "SOURCES",
    "Embedding",
    "Facet",
    "KnowledgeConfig",
    "KnowledgeGraph",
    "QueryEmbedding",
    "SceneEmbedding",
    "gamma",
    "graph_of",
    "household",
    "query_embedding",
    "read_graph",
    "scene_embedding",
    "scene_sentences",
    "scene_subgraph",
    "sentence",
    "write_graph",
]
