"""Facets of the choose task, shared by the tests of queries."""

from knowarm.knowledge.formats import shipped_graph

OBJECTS = sorted(
    {
        head
        for head, relation, _ in shipped_graph("objects")
        if relation == "isLocatedIn"
    }
)
"""Objects of the shipped graph "objects"."""

COLOURS = [
    "red",
    "orange",
    "yellow",
    "green",
    "cyan",
    "blue",
    "purple",
    "pink",
    "brown",
]

CHOICE = [(name, colour) for name in OBJECTS for colour in COLOURS]
"""Facets of the choose task."""
