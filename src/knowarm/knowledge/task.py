"""The paper's objects and colours: which facets the task has."""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.term import local_name

TASK_COLOURS = {
    "mug": ("red", "blue"),
    "bottle": ("yellow", "purple"),
    "cereal_box": ("brown", "light_blue"),
}
"""Colours of the paper's targets; the first is the fixed one."""


def task_facets(
    objects: Sequence[str],
    colours: Literal["fixed", "randomized"],
    graph: KnowledgeGraph,
    colour_relation: str = "hasColor",
) -> list[tuple[str, str]]:
    """Return (object, colour) pairs in the environment's order.

    Objects beyond the paper's three take the colours that the graph gives them, by name; one
    without a colour gets the pair (object, ""), which only `detail="partial"` takes.
    """
    pairs = []
    for name in objects:
        known = TASK_COLOURS.get(name) or _graph_colours(name, graph, colour_relation) or ("",)
        pairs += [(name, colour) for colour in (known[:1] if colours == "fixed" else known)]
    return pairs


def _graph_colours(name: str, graph: KnowledgeGraph, relation: str) -> tuple[str, ...]:
    rows = graph.out_rows(graph.entity_id(name))
    exact = graph.relation_names.find(relation)
    wanted = graph.relation_names.find_local(relation) if exact is None else [exact]
    tails = graph.tails[rows][np.isin(graph.relations[rows], wanted)]
    return tuple(local_name(graph.names[i]) for i in np.sort(tails))
