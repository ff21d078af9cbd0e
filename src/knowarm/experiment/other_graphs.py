"""Other graphs than that of training, and what an agent knows and answers by them."""

from collections.abc import Collection
from typing import Any, Literal

import numpy as np
import torch

from knowarm.config import override
from knowarm.errors import UserError
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.graph_queries import GraphQueries
from knowarm.knowledge import KnowledgeGraph, query_embedding, scene_embedding
from knowarm.knowledge.formats import read_graph
from knowarm.knowledge.graph.builder import shuffle_tails
from knowarm.knowledge.graph.terms import local_name
from knowarm.knowledge.queries.queries import QueryGraph
from knowarm.knowledge.queries.splits import QuerySplits
from knowarm.perception.config import ModuleSpec
from knowarm.perception.images import DescribedGraph, query_answers
from knowarm.questions import ObjectColour, Query, QuestionTable
from knowarm.seeding import derive_seed
from knowarm.world.config import EnvConfig, facets_of, questions_of


def check_graph(config: ExperimentConfig, env: EnvConfig) -> None:
    """Refuse another graph of the questions for an agent whose knowledge is of a third one."""
    asked, known = _source(env).graph, config.knowledge.graph
    if asked != known and config.knowledge.detail != "none":
        raise UserError(
            f"This test changes the graph of the questions ({asked}); the policy was trained with "
            f"knowledge from {known}. Train with knowledge.graph set to the former."
        )


def with_graph(config: ExperimentConfig, path: str) -> ExperimentConfig:
    """Return an experiment whose questions and answers come from another graph.

    It shows the objects that the graph describes and asks all that the graph can be asked.

    Args:
        config: of a task with queries.
        path: of the graph, or the name of a shipped one.
    """
    _questions(config.env)
    known = described(read_graph(path), target_names(config.env))
    shown = [name for name, is_known in zip(config.env.targets, known, strict=True) if is_known]
    if len(shown) < config.env.task.visible:
        raise UserError(
            f"The graph {path} describes {len(shown)} objects of the task "
            f"({', '.join(shown) or 'none'}), and an episode shows {config.env.task.visible}. Give "
            "a graph with triples about more of them."
        )
    queries = {"graph": path, "hold_out": []}
    env = {"targets": shown, "task": {"queries": queries}}
    return override(config, {"env": env, "knowledge": {"graph": path}})


def described(graph: KnowledgeGraph, names: Collection[str]) -> list[bool]:
    """Return which names a graph describes."""
    known = set(map(local_name, graph.entities))
    return [local_name(name) in known for name in names]


def knowledge_at_test(
    config: ExperimentConfig, env: EnvConfig, graph: KnowledgeGraph | None
) -> np.ndarray:
    """Compute the knowledge table by another graph: (Q, K), or (F, K) if perceived."""
    if config.knowledge.scope == "perceived":
        facets = facets_of(env)
        seen = scene_embedding(config.knowledge, facets, run_seed=config.seed, graph=graph)
        return seen.table(facets)
    tested = _questions(env).queries
    options: dict[str, Any] = {"graph": graph, "trained_on": _questions(config.env).queries}
    return query_embedding(config.knowledge, tested, run_seed=config.seed, **options).table(tested)


def described_by(config: ExperimentConfig, graph: KnowledgeGraph) -> DescribedGraph:
    """Describe and answer the queries of training by a graph; what is held out is not askable."""
    assert config.grounding is not None
    facets = ModuleSpec.of(config.env, config.grounding).facets
    answers = torch.from_numpy(QueryGraph(graph, facets).answers(_questions(config.env).queries))
    own = query_answers(config.env, facets)
    assert own is not None
    known = own._replace(satisfies=answers, askable=answers & (own.askable | ~own.satisfies))
    return knowledge_at_test(config, config.env, graph), known


def varied_graphs(config: ExperimentConfig) -> list[DescribedGraph]:
    """Return what `GroundingConfig.graphs` asks for: the agent's graph, and others; or nothing."""
    count = config.grounding.graphs if config.grounding is not None else 0
    graph = read_graph(config.knowledge.graph)
    seeds = (derive_seed(config.seed, "placebos", number) for number in range(count))
    graphs = [graph, *(shuffle_tails(graph, seed) for seed in seeds)]
    return [described_by(config, each) for each in graphs] if count else []


def answer_table(
    config: ExperimentConfig,
    env: EnvConfig,
    facets: tuple[ObjectColour, ...],
    *,
    graph: KnowledgeGraph | None = None,
    control: Literal["graph-shuffled", "colours"] | None = None,
) -> np.ndarray:
    """Return which facets answer each query of a task by the graph of an agent, (Q, F) bool.

    Objects that the graph does not describe never answer.

    Args:
        config: the agent; its source of vectors may be a placebo with a shuffled graph.
        env: the task that asks.
        facets: the F columns.
        graph: in place of the agent's own graph.
        control: "graph-shuffled" permutes the tails within each relation; "colours" knows no
            facts, so that only a query's colour restricts the answers.
    """
    queries, source = _questions(env).queries, config.knowledge.source
    graph = read_graph(config.knowledge.graph) if graph is None else graph
    graph = source.change_graph(graph, source.draw_seed(config.knowledge.seed, config.seed))
    if control == "graph-shuffled":
        graph = shuffle_tails(graph, derive_seed(config.seed, "placebos"))
    if control == "colours":
        queries = tuple(Query(tuple(c for c in q.conditions if c.is_seen)) for q in queries)
    known = np.array(described(graph, [name for name, _ in facets]))
    answers = np.zeros((len(queries), len(facets)), bool)
    shown = [facet for facet, is_known in zip(facets, known, strict=True) if is_known]
    answers[:, known] = QueryGraph(graph, shown).answers(queries)
    return answers


def answers_before_edit(env: EnvConfig) -> dict[str, set[str]]:
    """Return the objects that answered each query of S5 before the edit, in any colour, by name."""
    before = splits_of(env).train
    return {
        query.name: {before.facets[facet][0] for facet in np.flatnonzero(row)}
        for query, row in zip(before.queries, before.satisfies, strict=True)
    }


def target_names(env: EnvConfig) -> list[str]:
    """Return the names of the targets, some of which may be given as files."""
    return list(dict.fromkeys(name for name, _ in facets_of(env)))


def _questions(env: EnvConfig) -> QuestionTable:
    table = questions_of(env)
    if table is None:
        raise _no_queries(env)
    return table


def splits_of(env: EnvConfig) -> QuerySplits:
    """Return the splits of the questions of a task."""
    return _source(env).splits(facets_of(env), env.task.visible)


def _source(env: EnvConfig) -> GraphQueries:
    source = env.task.query_source
    if not isinstance(source, GraphQueries):
        raise _no_queries(env)
    return source


def _no_queries(env: EnvConfig) -> UserError:
    return UserError(
        f"The task {env.task.kind_of()!r} has no queries that a graph could answer. Take a run of "
        "the choose task."
    )
