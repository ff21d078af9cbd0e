"""Knowledge: from a graph of triples to the vector that a policy receives.

The steps are `read_graph`, `gamma` (the subgraph around the perceived objects), `sentence` (its
labels in order), a vector source (see `knowledge.vectors`) and `scene_embedding`.
"""

from knowarm.knowledge.builder import graph_of
from knowarm.knowledge.config import FULL, FULL_PLUS, QUERY, KnowledgeConfig
from knowarm.knowledge.embedding import SceneEmbedding, scene_embedding
from knowarm.knowledge.facets import Facet
from knowarm.knowledge.formats import household, read_graph, write_graph
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.query_embedding import QueryEmbedding, query_embedding
from knowarm.knowledge.scene import scene_sentences, scene_subgraph
from knowarm.knowledge.sentence import sentence
from knowarm.knowledge.subgraph import gamma
from knowarm.knowledge.vectors import SOURCES, migrate_source

__all__ = [
    "FULL",
    "FULL_PLUS",
    "QUERY",
    "SOURCES",
    "Facet",
    "KnowledgeConfig",
    "KnowledgeGraph",
    "QueryEmbedding",
    "SceneEmbedding",
    "gamma",
    "graph_of",
    "household",
    "migrate_source",
    "query_embedding",
    "read_graph",
    "scene_embedding",
    "scene_sentences",
    "scene_subgraph",
    "sentence",
    "write_graph",
]
