"""Queries of a graph, as the source of queries of the choice task."""

from dataclasses import dataclass
from typing import Literal

from knowarm.errors import UserError
from knowarm.knowledge.formats import open_graph
from knowarm.knowledge.queries import Pairs
from knowarm.knowledge.query_splits import DRAWN, SPLITS, query_splits
from knowarm.world.choice import ChoiceTable, Facet
from knowarm.world.choice_config import QUERY_SOURCES, QuerySource


@dataclass(frozen=True, kw_only=True)
class GraphQueries(QuerySource):
    """Asks for objects by what a graph knows about them, in training or in the test of a split."""

    kind: Literal["graph"] = "graph"
    """Tag of this source in JSON."""

    graph: str = "objects"
    """Path of the graph, or the name of a shipped one."""

    split: Literal["train", "S1", "S2", "S3", "S4", "S5"] = "train"
    """What is asked: the questions of training, or those of a split's test."""

    hold_out: tuple[str, ...] = tuple(DRAWN)
    """Splits for which training leaves something out; the others have no test but S1 and S5."""

    pairs: Pairs = "colour"
    """Which queries have two conditions: "none", a fact and a "colour", or "all"."""

    seed: int = 0
    """Seed of what is held out."""

    edited: str | None = None
    """Path of the graph of S5; None draws its edits."""

    def __post_init__(self) -> None:
        if self.split not in ("train", *SPLITS):
            raise UserError(
                f"GraphQueries.split must be train or one of {', '.join(SPLITS)}, got "
                f"{self.split!r}."
            )

    def table(self, facets: tuple[Facet, ...], objects: int) -> ChoiceTable:
        """Make the table of the split."""
        splits = query_splits(
            open_graph(self.graph),
            facets,
            seed=self.seed,
            pairs=self.pairs,
            objects=objects,
            hold_out=self.hold_out,
            edited=None if self.edited is None else open_graph(self.edited),
        )
        table = splits.train if self.split == "train" else splits.test(self.split)
        return ChoiceTable(
            queries=table.queries,
            facets=table.facets,
            satisfies=table.satisfies,
            askable=table.askable,
            related=table.related,
            shown=table.shown,
        )


QUERY_SOURCES["graph"] = GraphQueries
