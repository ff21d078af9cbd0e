"""Named experiments: the config of every combination of robot, task, agent, colours, algorithm."""

import dataclasses
from typing import Any

from knowarm.config import override
from knowarm.experiment.agents import AGENTS
from knowarm.experiment.algorithms import ALGORITHMS
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.graph_queries import GraphQueries
from knowarm.experiment.names import ExperimentName
from knowarm.knowledge import QUERY
from knowarm.world.config import EnvConfig
from knowarm.world.tasks import task_type
from knowarm.world.tasks.task import Task

TASK_FIELDS: dict[str, dict[str, Any]] = {"choose": {"queries": GraphQueries()}}
"""Fields of tasks that have other values in the named experiments, by task."""


def experiment_config(name: str, **overrides: Any) -> ExperimentConfig:
    """Return the config of a named experiment.

    Args:
        name: as `ExperimentName.parse` reads it, such as ``irb120-full-ppo``.
        **overrides: fields to change; a nested config takes a mapping of its fields, such as
            ``algorithm={"num_envs": 64}``.

    Raises:
        UserError: there is no experiment of that name (the message lists the nearest names), or an
            override does not fit.
    """
    config = _config(ExperimentName.parse(name))
    return override(config, overrides) if overrides else config


def task_for(name: str, **fields: Any) -> Task:
    """Return a task of ``task_names`` as the named experiments have it, with fields changed."""
    return override(task_type(name)(), {**TASK_FIELDS.get(name, {}), **fields})


def _config(name: ExperimentName) -> ExperimentConfig:
    agent, algorithm = AGENTS[name.agent], ALGORITHMS[name.algorithm]
    task, knowledge = task_for(name.task, **agent.task), agent.knowledge
    if knowledge.scope == "perceived" and "query" in task.scopes:
        # described by the graph of the questions
        knowledge = dataclasses.replace(knowledge, graph=QUERY.graph, aliases=QUERY.aliases)
    config = ExperimentConfig(
        name=str(name),
        agent=name.agent,
        algorithm_name=name.algorithm,
        role=agent.role,
        total_steps=algorithm.total_steps,
        env=EnvConfig(robot=name.robot, task=task, colours=name.colours),
        knowledge=knowledge,
        policy=dataclasses.replace(agent.policy, **algorithm.policy),
        grounding=agent.grounding,
        algorithm=algorithm.config,
    )
    return override(config, algorithm.by_task.get(name.task, {}))
