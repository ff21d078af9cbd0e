"""Sources of the questions that episodes ask: names, or what a graph states."""

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np

from knowarm.errors import UserError
from knowarm.knowledge import KnowledgeGraph
from knowarm.knowledge.formats import SHIPPED, read_graph
from knowarm.knowledge.queries.queries import Pairs
from knowarm.knowledge.queries.splits import HELD_OUT, QuerySplits, Split, query_splits
from knowarm.questions import (
    COLOUR_RELATION,
    Query,
    QuestionTable,
    number_parts,
    with_distractors,
)
from knowarm.world.tasks.sampling import Facets


@dataclass(frozen=True, kw_only=True)
class QuerySource:
    """Base of the configs that make a question table."""

    def table(self, facets: Facets, objects: int) -> QuestionTable:
        """Make the table of the facets that can be shown, for a number of objects per episode."""
        raise NotImplementedError

    def version(self) -> tuple[int, ...]:
        """Return numbers that change where files that the questions follow from change."""
        return ()

    @property
    def graph_path(self) -> str | None:
        """Path of the graph that answers, or the name of a shipped one; None without a graph."""
        return None

    def edited_graph(self, facets: Facets, objects: int) -> KnowledgeGraph | None:
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

    def table(self, facets: Facets, objects: int) -> QuestionTable:
        """Make a table with one query per object and one per colour."""
        parts = {
            "object": ("isA", [name for name, _ in facets]),
            "colour": (COLOUR_RELATION, [colour for _, colour in facets]),
        }
        rows: dict[Query, list[bool]] = {}
        for kind in self.ask:
            relation, values = parts[kind]
            for value in dict.fromkeys(values):
                rows[Query.of((relation, value))] = [value == other for other in values]
        satisfies = np.array(list(rows.values()), bool)
        count = len(facets)
        return QuestionTable(
            queries=tuple(rows),
            facets=facets,
            satisfies=satisfies,
            askable=satisfies,
            related=np.ones((count, count), bool),
            shown=np.ones(count, bool),
        )


@dataclass(frozen=True, kw_only=True)
class GraphQueries(QuerySource):
    """Queries for objects by what a graph states about them, for training or a split's test."""

    kind: Literal["graph"] = "graph"
    """Tag of this source in JSON."""
    graph: str = "objects"
    """Path of the graph, or the name of a shipped one."""
    split: Split = "train"
    """The questions of training, or those of a split's test."""
    hold_out: tuple[str, ...] = HELD_OUT
    """Splits for which training leaves something out; the others have no test but S1 and S5."""
    pairs: Pairs = "colour"
    """Which queries have two conditions: "none", a fact and a "colour", or "all"."""
    seed: int = 0
    """Seed of what is held out; 7_100_003 and 7_200_003 are the declared draws of validation and
    test, which leave alone what the published draw, 0, holds out."""
    edited: str | None = None
    """Path of the graph of S5; None draws its edits."""

    def table(self, facets: Facets, objects: int) -> QuestionTable:
        """Make the table of the split."""
        splits = self.splits(facets, objects)
        if self.split == "train":
            return splits.train
        return splits.test(self.split)

    def version(self) -> tuple[int, ...]:
        """Return when the files of the graphs were last written."""
        written = []
        for name in (self.graph, self.edited):
            if not name or name in SHIPPED:
                continue
            path = Path(name)
            files = [path, *path.glob("*")]
            written += [file.stat().st_mtime_ns for file in files if file.exists()]
        return tuple(sorted(written))

    @property
    def graph_path(self) -> str:
        """Path of the graph, or the name of a shipped one."""
        return self.graph

    def edited_graph(self, facets: Facets, objects: int) -> KnowledgeGraph | None:
        """Return the graph of split S5 where its questions are asked."""
        if self.split != "S5":
            return None
        return self.splits(facets, objects).edited

    def splits(self, facets: Facets, objects: int) -> QuerySplits:
        """Make the tables of training and of all tests; cached per `version`."""
        return _splits(replace(self, split="train"), facets, objects, self.version())


@lru_cache(maxsize=16)
def question_table(
    queries: QuerySource, facets: Facets, objects: int, version: tuple[int, ...]
) -> QuestionTable:
    """Return the questions of a source about facets, of which an episode shows ``objects``.

    Facets that are parts are shown with all parts of their objects; a query is asked for a part
    only if no other part of its object satisfies it. Cached per process and ``version`` of the
    source.
    """
    count = objects // number_parts(facets).shape[1]
    table = queries.table(facets, objects)
    parts = table.parts
    if parts.shape[1] == 1:
        return table
    shown = np.any(table.shown[parts], axis=1)
    related = np.any(table.related[:, parts], axis=2)
    related = np.any(related[parts], axis=1)
    satisfied = table.satisfies[:, parts]
    askable = table.askable & (satisfied.sum(axis=2) == 1)
    by_object = np.any(satisfied, axis=2)
    askable = with_distractors(askable, by_object, related, shown, table.objects, count)
    return replace(table, askable=askable, related=related, shown=shown)


@lru_cache(maxsize=4)
def _splits(
    source: GraphQueries, facets: Facets, objects: int, version: tuple[int, ...]
) -> QuerySplits:
    return query_splits(
        read_graph(source.graph),
        facets,
        seed=source.seed,
        pairs=source.pairs,
        objects=objects,
        hold_out=source.hold_out,
        edited=None if source.edited is None else read_graph(source.edited),
    )
