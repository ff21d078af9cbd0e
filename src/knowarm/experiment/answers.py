"""Answers of graphs to the questions of a task."""

from collections.abc import Collection, Mapping
from contextlib import suppress

import numpy as np

from knowarm.errors import UserError
from knowarm.knowledge import KnowledgeGraph
from knowarm.knowledge.graph.names import AmbiguousNameError
from knowarm.knowledge.queries.queries import QueryGraph
from knowarm.questions import ObjectColour, Query, QuestionTable
from knowarm.world.config import EnvConfig, questions_of


def asked(env: EnvConfig) -> QuestionTable:
    """Return the questions of a task, which must have some."""
    table = questions_of(env)
    if table is None:
        raise UserError(
            f"The task {env.task.name!r} has no queries that a graph could answer. Take a run "
            "of the choose task."
        )
    return table


def described(graph: KnowledgeGraph, names: Collection[str]) -> list[bool]:
    """Return which names a graph describes."""
    known = {name: graph.described(name) is not None for name in dict.fromkeys(names)}
    return [known[name] for name in names]


def meeting(
    graph: KnowledgeGraph, objects: Collection[str], names: Mapping[str, str] | None = None
) -> dict[str, list[str]]:
    """Return how the objects that a policy recognizes and those that a graph describes meet.

    Args:
        graph: the graph; it describes what is the head of a triple and the tail of none.
        objects: what the policy recognizes.
        names: the graph's names for objects, where they differ by more than their spelling.
    """
    known, missing = dict[int, str](), list[str]()
    for name in dict.fromkeys(objects):
        entity = None
        with suppress(AmbiguousNameError):
            entity = graph.find_entity((names or {}).get(name, name))
        if entity is None:
            missing.append(name)
        else:
            known[entity] = name
    others = [i for i in np.setdiff1d(graph.heads, graph.tails).tolist() if i not in known]
    named = [graph.names.short(i) for i in others if not graph.names[i].startswith("_:")]
    return {
        "recognized and described": [*known.values()],
        "recognized only": missing,
        "described only": named,
    }


def answers_by(
    graph: KnowledgeGraph,
    env: EnvConfig,
    facets: tuple[ObjectColour, ...],
    *,
    colours_only: bool = False,
) -> np.ndarray:
    """Return the probability that each of F facets answers each query of a task, (Q, F) float32.

    It is 0 or 1, but for triples with a confidence.

    Objects that the graph does not describe never answer. With ``colours_only`` no facts are known,
    so that only a query's colour restricts the answers.
    """
    queries = asked(env).queries
    if colours_only:
        queries = tuple(Query(tuple(c for c in q.conditions if c.is_seen)) for q in queries)
    known = np.array(described(graph, [name for name, _ in facets]))
    answers = np.zeros((len(queries), len(facets)), np.float32)
    shown = [facet for facet, is_known in zip(facets, known, strict=True) if is_known]
    answers[:, known] = QueryGraph(graph, shown).degrees(queries)
    return answers
