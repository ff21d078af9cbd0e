"""A graph goes in; a file of it comes out."""

from knowarm.knowledge.write.write import WRITERS, write_graph

__all__ = ["WRITERS", "write_graph"]
