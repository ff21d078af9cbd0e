"""Sources of the questions that episodes ask."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from knowarm.errors import UserError
from knowarm.own import load
from knowarm.questions import COLOUR_RELATION, ObjectColour, Query, QuestionTable


@dataclass(frozen=True, kw_only=True)
class QuerySource:
    """Base of the configs that make a question table."""

    def table(self, facets: tuple[ObjectColour, ...], objects: int) -> QuestionTable:
        """Make the table of the facets that can be shown, for a number of objects per episode."""
        raise NotImplementedError

    def version(self) -> tuple[int, ...]:
        """Return numbers that change where files that the questions follow from change."""
        return ()

    @property
    def graph_path(self) -> str | None:
        """Path of the graph that answers, or the name of a shipped one; None without a graph."""
        return None

    def edited_graph(self, facets: tuple[ObjectColour, ...], objects: int) -> Any:
        """Return the graph that answers instead of ``graph_path``, of split S5; else None."""
        return None


@dataclass(frozen=True, kw_only=True)
class NameQueries(QuerySource):
    """Objects and colours by their names, without a graph; any two facets are related."""

    kind: Literal["names"] = "names"
    """Tag of this source in JSON."""
    ask: tuple[Literal["object", "colour"], ...] = ("object", "colour")
    """Which names are queries."""

    def __post_init__(self) -> None:
        if not self.ask or not set(self.ask) <= {"object", "colour"}:
            raise UserError(
                f"NameQueries.ask must name object, colour or both, got {self.ask}; give at least "
                "one."
            )

    def table(self, facets: tuple[ObjectColour, ...], objects: int) -> QuestionTable:
        """Make a table with one query per object and one per colour."""
        place = {"object": ("isA", 0), "colour": (COLOUR_RELATION, 1)}
        rows: dict[Query, list[bool]] = {}
        for relation, part in (place[name] for name in self.ask):
            for value in dict.fromkeys(facet[part] for facet in facets):
                rows[Query.of((relation, value))] = [facet[part] == value for facet in facets]
        satisfies = np.array(list(rows.values()), dtype=np.bool_)
        count = len(facets)
        return QuestionTable(
            queries=tuple(rows),
            facets=facets,
            satisfies=satisfies,
            askable=satisfies,
            related=np.ones((count, count), dtype=np.bool_),
            shown=np.ones(count, dtype=np.bool_),
        )


QUERY_SOURCES: dict[str, str] = {
    "names": "knowarm.world.tasks.query_source:NameQueries",
    "graph": "knowarm.experiment.graph_queries:GraphQueries",
}
"""Sources of questions by their tag, as ``package.module:Name``. To add one, add an entry."""


def graph_queries(**options: Any) -> QuerySource:
    """Make the source of questions that a graph answers, with fields of ``GraphQueries``."""
    return source_type("graph")(**options)


def source_type(name: str) -> type[QuerySource]:
    """Return the class of a name in ``QUERY_SOURCES``."""
    source: type[QuerySource] = load(
        QUERY_SOURCES[name],
        "source of questions",
        lambda each: isinstance(each, type) and issubclass(each, QuerySource),
        "a class derived from knowarm.world.tasks.query_source.QuerySource",
    )
    return source
