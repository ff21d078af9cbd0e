"""Anyone's triples go in; a vector that keeps what it was given comes out.

read_graph -> gamma -> sentence -> vectors -> scene_embedding
"""

from knowarm.knowledge.builder import graph_of
from knowarm.knowledge.config import KnowledgeConfig
from knowarm.knowledge.embedding import SceneEmbedding, scene_embedding
from knowarm.knowledge.facets import Facet
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.household import household
from knowarm.knowledge.presets import KNOWLEDGE
from knowarm.knowledge.read import read_graph
from knowarm.knowledge.scene import scene_sentences, scene_subgraph
from knowarm.knowledge.sentence import sentence
from knowarm.knowledge.subgraph import gamma

__all__ = [
    "KNOWLEDGE",
    "Facet",
    "KnowledgeConfig",
    "KnowledgeGraph",
    "SceneEmbedding",
    "gamma",
    "graph_of",
    "household",
    "read_graph",
    "scene_embedding",
    "scene_sentences",
    "scene_subgraph",
    "sentence",
]
