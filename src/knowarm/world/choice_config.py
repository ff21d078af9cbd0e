"""Configuration of the choice task: number of objects, and where its queries come from."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from knowarm.config import check_numbers, registered
from knowarm.errors import UserError
from knowarm.world.choice import ChoiceTable, Facet

MAX_OBJECTS = 6


@dataclass(frozen=True, kw_only=True)
class QuerySource:
    """Base of the configs that make a choice table."""

    def table(self, facets: tuple[Facet, ...], objects: int) -> ChoiceTable:
        """Make the table.

        Args:
            facets: the (object, colour) pairs that the environment can show.
            objects: number of objects per episode.
        """
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class NameQueries(QuerySource):
    """Asks for objects and colours by their names, without a graph; any two facets are related."""

    kind: Literal["names"] = "names"
    """Tag of this source in JSON."""

    ask: tuple[Literal["object", "colour"], ...] = ("object", "colour")
    """What is asked for."""

    def __post_init__(self) -> None:
        if not self.ask or not set(self.ask) <= {"object", "colour"}:
            raise UserError(
                f"NameQueries.ask must name object, colour or both, got {self.ask}; give at least "
                "one."
            )

    def table(self, facets: tuple[Facet, ...], objects: int) -> ChoiceTable:
        """Make a table with one query per object and one per colour."""
        words: dict[str, Callable[[Facet], str]] = {
            "object": lambda facet: f"isA {facet[0]}",
            "colour": lambda facet: f"hasColor {facet[1]}",
        }
        rows: dict[str, list[bool]] = {}
        for name in self.ask:
            for query in dict.fromkeys(map(words[name], facets)):
                rows[query] = [words[name](facet) == query for facet in facets]
        satisfies = np.array(list(rows.values()), dtype=np.bool_)
        count = len(facets)
        return ChoiceTable(
            queries=tuple(rows),
            facets=facets,
            satisfies=satisfies,
            askable=satisfies,
            related=np.ones((count, count), dtype=np.bool_),
            shown=np.ones(count, dtype=np.bool_),
        )


QUERY_SOURCES: dict[str, type[QuerySource]] = {"names": NameQueries}
"""Sources of queries by their tag. ``experiment.graph_queries`` adds those of a graph."""


@dataclass(frozen=True, kw_only=True)
class ChoiceConfig:
    """Several objects in the rectangle, of which the episode's query means exactly one."""

    objects: int = 4
    """Objects per episode, 2 to 6, all different."""

    queries: QuerySource = field(
        default_factory=NameQueries, metadata=registered(lambda: QUERY_SOURCES.values())
    )
    """Which queries are asked, and which objects answer them."""

    marked: bool = False
    """Paint the wanted object in magenta and the others grey: shows the answer instead of asking
    the question, the upper bound of what a query can give."""

    def __post_init__(self) -> None:
        check_numbers(self)
        if not 2 <= self.objects <= MAX_OBJECTS:
            raise UserError(
                f"ChoiceConfig.objects must be 2 to {MAX_OBJECTS}, got {self.objects}. One object "
                "is the reaching task: leave out choice."
            )
