"""Split S5: knowledge of a trained policy from an edited graph, and the answers before the edit."""

from typing import Any

import numpy as np

from knowarm.errors import UserError
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.graph_queries import GraphQueries
from knowarm.knowledge import query_embedding, scene_embedding
from knowarm.knowledge.queries.splits import QuerySplits
from knowarm.world.config import EnvConfig, facets_of
from knowarm.world.tasks.choose.choose import Choose


def edited_knowledge_table(config: ExperimentConfig, env: EnvConfig) -> np.ndarray:
    """Compute the knowledge table from the edited graph of S5: (Q, K), or (F, K) if perceived."""
    queries, splits = _splits(env)
    if config.knowledge.graph != queries.graph and config.knowledge.detail != "none":
        raise UserError(
            f"S5 edits the graph of the questions ({queries.graph}), but the policy was trained "
            f"with knowledge from {config.knowledge.graph}. Train with knowledge.graph set to the "
            "former."
        )
    if config.knowledge.scope == "perceived":
        facets = facets_of(env)
        seen = scene_embedding(config.knowledge, facets, run_seed=config.seed, graph=splits.edited)
        return seen.table(facets)
    tested = splits.test("S5").queries
    options: dict[str, Any] = {"graph": splits.edited, "trained_on": splits.train.queries}
    return query_embedding(config.knowledge, tested, run_seed=config.seed, **options).table(tested)


def answers_before_edit(env: EnvConfig) -> dict[str, set[str]]:
    """Return the objects that answered each query of S5 before the edit, in any colour, by name."""
    before = _splits(env)[1].train
    return {
        query.name: {before.facets[facet][0] for facet in np.flatnonzero(row)}
        for query, row in zip(before.queries, before.satisfies, strict=True)
    }


def _splits(env: EnvConfig) -> tuple[GraphQueries, QuerySplits]:
    task = env.task
    assert isinstance(task, Choose)
    assert isinstance(task.queries, GraphQueries)
    return task.queries, task.queries.splits(facets_of(env), task.objects)
