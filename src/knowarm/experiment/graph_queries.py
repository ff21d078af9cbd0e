"""Queries of a graph, as the source of queries of the choice task."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from knowarm.errors import UserError
from knowarm.knowledge.embedding import scene_embedding
from knowarm.knowledge.formats import open_graph
from knowarm.knowledge.queries import Pairs
from knowarm.knowledge.query_embedding import query_embedding
from knowarm.knowledge.query_splits import DRAWN, SPLITS, QuerySplits, query_splits
from knowarm.world.choice import ChoiceTable, Facet
from knowarm.world.choice_config import QUERY_SOURCES, QuerySource
from knowarm.world.choice_source import choice_table
from knowarm.world.config import EnvConfig
from knowarm.world.scene import list_facets, scene_of

if TYPE_CHECKING:
    from knowarm.experiment.config import ExperimentConfig


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
        splits = self.splits(facets, objects)
        table = splits.train if self.split == "train" else splits.test(self.split)
        return ChoiceTable(
            queries=table.queries,
            facets=table.facets,
            satisfies=table.satisfies,
            askable=table.askable,
            related=table.related,
            shown=table.shown,
        )

    def splits(self, facets: tuple[Facet, ...], objects: int) -> QuerySplits:
        """Make the tables of training and of all tests."""
        return query_splits(
            open_graph(self.graph),
            facets,
            seed=self.seed,
            pairs=self.pairs,
            objects=objects,
            hold_out=self.hold_out,
            edited=None if self.edited is None else open_graph(self.edited),
        )


def retold(config: "ExperimentConfig", env: EnvConfig) -> np.ndarray:
    """Compute the knowledge table of a trained policy from the edited graph of S5.

    Args:
        config: the experiment that trained the policy.
        env: the task of the test, with the queries of S5.

    Returns:
        (Q, K) float32, one row per query of the test; per facet, (F, K), where knowledge describes
        what is perceived.

    Raises:
        UserError: the knowledge comes from another graph than the queries.
    """
    assert env.choice is not None
    queries = env.choice.queries
    assert isinstance(queries, GraphQueries)
    if config.knowledge.graph != queries.graph and config.knowledge.detail != "none":
        raise UserError(
            f"S5 edits the graph of the queries ({queries.graph}), but the policy was told about "
            f"them from {config.knowledge.graph}. Train with knowledge.graph set to the former."
        )
    splits = queries.splits(choice_table(env).facets, env.choice.objects)
    if config.knowledge.scope == "perceived":
        facets = list_facets(scene_of(env), env.colours)
        seen = scene_embedding(config.knowledge, facets, run_seed=config.seed, graph=splits.edited)
        return seen.table(facets)
    embedding = query_embedding(
        config.knowledge,
        splits.test("S5").queries,
        run_seed=config.seed,
        graph=splits.edited,
        trained_on=splits.train.queries,
    )
    return embedding.table(splits.test("S5").queries)


def old_answers(env: EnvConfig) -> dict[str, set[str]]:
    """Return the objects that answered each query of S5 before the graph was edited, by name.

    An object in any of its colours counts.
    """
    assert env.choice is not None
    queries = env.choice.queries
    assert isinstance(queries, GraphQueries)
    before = queries.splits(choice_table(env).facets, env.choice.objects).train
    return {
        text: {before.facets[facet][0] for facet in np.flatnonzero(row)}
        for text, row in zip(before.queries, before.satisfies, strict=True)
    }


QUERY_SOURCES["graph"] = GraphQueries
