"""Other graphs of the questions than that of training."""

import warnings
from collections.abc import Collection, Mapping
from dataclasses import replace
from itertools import compress
from pathlib import Path

import numpy as np

from knowarm.config import override
from knowarm.errors import DataWarning, UserError
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.knows import NoKnowledge, asked, described
from knowarm.knowledge import KnowledgeGraph
from knowarm.knowledge.formats import read_graph, write_graph
from knowarm.knowledge.graph.builder import with_facts
from knowarm.knowledge.graph.homonyms import find_object
from knowarm.knowledge.graph.individuals import individuals_of, meant
from knowarm.knowledge.graph.terms import RDF_TYPE
from knowarm.world.cache import cache_file
from knowarm.world.config import EnvConfig, facets_of


def check_graph(config: ExperimentConfig, env: EnvConfig) -> None:
    """Refuse another graph of the questions for an agent whose knowledge is of a third one."""
    questions = env.task.asked.graph
    if questions is None or isinstance(config.knows, NoKnowledge):
        return
    if config.knows.graph != questions:
        raise UserError(
            f"This test changes the graph of the questions ({questions}); the policy was trained "
            "with knowledge from another one. Train with knows.graph set to that of the questions."
        )


def with_graph(
    config: ExperimentConfig,
    graph: KnowledgeGraph | Path | str,
    names: Mapping[str, str] | None = None,
) -> ExperimentConfig:
    """Return an experiment whose questions and answers come from another graph.

    It shows the objects that the graph describes and asks all that the graph can be asked.

    Args:
        config: of a task with queries.
        graph: the graph, its path, or the name of a shipped one.
        names: its names for objects, where they differ by more than their spelling.
    """
    path = _cached(graph) if isinstance(graph, KnowledgeGraph) else str(graph)
    path = _with_names(path, names) if names else path
    task = config.env.task.asking(graph=path, hold_out=())
    graph = read_graph(path)
    is_described = described(graph, target_names(config.env))
    targets = tuple(compress(config.env.targets, is_described))
    if len(targets) < config.env.task.asked.visible:
        raise UserError(
            f"The graph {path} describes {len(targets)} objects of the task "
            f"({', '.join(targets) or 'none'}), and an episode shows "
            f"{config.env.task.asked.visible}. Give a graph with triples about more of them."
        )
    env = replace(config.env, task=task, targets=targets)
    return override(config, {"env": env, "knows": {"graph": path}})


def _with_names(path: str, names: Mapping[str, str]) -> str:
    """Write a graph in which objects are labelled as the task names them; return its path."""
    graph = read_graph(path).stated()
    labels = dict(graph.labels)
    for name, other in names.items():
        if graph.find_entity(other) is None:  # it may be the word of individuals alone
            individuals = graph.names.at(individuals_of(graph, other, None))
            typed = [(individual, RDF_TYPE, other) for individual in individuals]
            graph = with_facts(graph, typed).stated()
        entity = graph.entity_id(other)
        namesake = find_object(graph, name)
        if namesake is not None and namesake != entity:
            raise UserError(
                f"The graph {path} has an entity {graph.names[namesake]!r} of its own, so that "
                f"{name!r} cannot name {other!r}, too. Leave {name}={other} out."
            )
        labels[graph.names[entity]] = name
    labelled = KnowledgeGraph(
        graph.names,
        graph.relation_names,
        graph.triples,
        nodes=graph.nodes,
        labels=labels,
        confidence=graph.own_confidence(),
    )
    return _cached(labelled)


def _cached(graph: KnowledgeGraph) -> str:
    """Write a graph to a file of the cache; return its path."""
    confidence = sorted(graph.own_confidence().items())
    follows = (list(graph), dict(graph.labels), *confidence)
    file = cache_file("graphs", *follows).with_suffix(".ttl")
    if not file.exists():
        file.parent.mkdir(parents=True, exist_ok=True)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataWarning)  # it is for KnowArm alone
            write_graph(graph, file)
    return str(file)


def meeting(
    graph: KnowledgeGraph,
    objects: Collection[str],
    names: Mapping[str, str] | None = None,
) -> dict[str, list[str]]:
    """Return how the objects that a policy recognizes and those that a graph describes meet.

    Args:
        graph: the graph; it describes what is the head of a triple and the tail of none.
        objects: what the policy recognizes.
        names: the graph's names for objects, where they differ by more than their spelling.
    """
    described_as = meant(graph, dict.fromkeys(objects), names or {})
    recognized = set[int]()
    for name in described_as:
        entity, individuals = described_as[name]
        recognized.update(individuals)
        if entity is not None:
            recognized.add(entity)
    described_only = []
    for other in np.setdiff1d(graph.heads, graph.tails).tolist():
        is_blank = graph.names[other].startswith("_:")
        if other not in recognized and not is_blank:
            described_only.append(graph.names.short(other))
    return {
        "recognized and described": list(described_as),
        "recognized only": [
            name for name in dict.fromkeys(objects) if name not in described_as
        ],
        "described only": described_only,
    }


def answers_before_edit(env: EnvConfig) -> dict[str, set[str]]:
    """Return the objects that answered each query of S5 before the edit, in any colour, by name."""
    before = asked(replace(env, task=env.task.asking(split="train")))
    answers = {}
    for query, is_answer in zip(before.queries, before.satisfies, strict=True):
        answers[query.name] = {name for name, _ in compress(before.facets, is_answer)}
    return answers


def target_names(env: EnvConfig) -> list[str]:
    """Return the names of the targets, some of which may be given as files."""
    return list(dict.fromkeys(name for name, _ in facets_of(env)))
