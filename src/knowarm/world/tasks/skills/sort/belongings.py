"""Belongings: at which places a graph says that objects belong."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from knowarm.arrays import Integers, Mask, Names
from knowarm.errors import UserError
from knowarm.knowledge import KnowledgeGraph
from knowarm.knowledge.formats import read_graph
from knowarm.knowledge.graph.individuals import meant
from knowarm.knowledge.queries.queries import QueryGraph
from knowarm.questions import Query
from knowarm.world.tasks.asked.asked import Asking
from knowarm.world.tasks.sampling import Facets

STANDARD = "objects"
"""Shipped graph that says it where no graph answers questions."""


class Belongings(NamedTuple):
    """Places of objects."""

    objects: tuple[str, ...]
    places: Names
    """Sorted, (P,)."""
    belongs: Mask
    """Whether an object belongs at a place, (objects, P)."""

    def of(self, objects: Integers, places: Names) -> Mask:
        """Return whether objects (n, m) belong at places (n, K) by name, (n, m, K) bool."""
        is_place = places[:, None, :, None] == self.places
        return (is_place & self.belongs[objects][:, :, None]).any(axis=3)


def belongings(
    graph: KnowledgeGraph | None, facets: Facets, relation: str
) -> Belongings:
    """Return where a graph says that the objects of facets belong.

    Those that it does not describe belong nowhere, as all do without a graph.
    """
    objects = tuple(dict.fromkeys(name for name, _ in facets))
    places: list[str] = []
    belongs = np.zeros((len(objects), 0), bool)
    described = [] if graph is None else list(meant(graph, objects, {}))
    if graph is not None and described:
        # Where an object belongs does not depend on its colour.
        asked = QueryGraph(graph, [(name, "") for name in described])
        stated = [part for part in asked.conditions if part.relation == relation]
        places = [condition.value for condition in stated]
        belongs = np.zeros((len(objects), len(places)), bool)
        rows = [objects.index(name) for name in described]
        belongs[rows] = asked.answers([Query((part,)) for part in stated]).T
    return Belongings(objects, np.array(places, np.str_), belongs)


@lru_cache(maxsize=4)
def true_belongings(asked: Asking, facets: Facets, relation: str) -> Belongings:
    """Return where the objects of a task belong by the graph that answers its questions.

    Raises:
        UserError: the graph says it of fewer than two places.
    """
    graph = asked.answering_graph(facets)
    if graph is None:
        graph = read_graph(STANDARD)
    known = belongings(graph, facets, relation)
    if len(known.places) < 2:
        others = {part.relation for part in QueryGraph(graph, facets).conditions}
        raise UserError(
            f"Objects are sorted by the values of {relation!r}, of which the graph states "
            f"{len(known.places)} for them. Set task.skill.relation to one of "
            f"{', '.join(sorted(others))}."
        )
    return known
