"""A file of triples in any known format goes in; a KnowledgeGraph comes out."""

from knowarm.knowledge.read.read import FORMATS, read_graph

__all__ = ["FORMATS", "read_graph"]
