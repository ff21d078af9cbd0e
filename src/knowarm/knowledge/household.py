"""Nothing goes in; the graph that comes with the package, hand-written, comes out."""

from functools import cache
from pathlib import Path

from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.read import read_graph

HOUSEHOLD = Path(__file__).parent / "data" / "household.ttl"
"""The shipped graph: 31 household objects and what a robot arm should know about them."""


@cache
def household() -> KnowledgeGraph:
    """Read the shipped graph, once a process."""
    return read_graph(HOUSEHOLD)
