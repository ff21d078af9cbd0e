"""Named experiments: every combination of robot, task, agent, target colours and algorithm.

Names are ``<robot>-<agent>[-dr]-<algorithm>``, such as ``irb120-full-ppo`` or ``tiago-bm-dr-a3c``;
``dr`` randomizes the targets' colours (paper section 4.2.5). In the choice task they are
``<robot>-choose-<agent>-<algorithm>``.
"""

import dataclasses
from collections.abc import Iterator
from typing import Any, Literal

from knowarm.config import replace
from knowarm.errors import unknown_name
from knowarm.experiment.agents import AGENTS, Agent, first_of_role
from knowarm.experiment.algorithms import ALGORITHMS
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.graph_queries import GraphQueries
from knowarm.knowledge import QUERY
from knowarm.knowledge.vectors.placebos import OneHot
from knowarm.world.choice_config import ChoiceConfig
from knowarm.world.config import EnvConfig, choice_env_config
from knowarm.world.robots import ROBOTS

Colours = Literal["fixed", "randomized"]

COLOURS: dict[str, Colours] = {"": "fixed", "-dr": "randomized"}
"""Colours of the targets by the suffix of the agent in an experiment's name."""


Task = Literal["reach", "choose"]


def experiment_name(
    robot: str,
    agent: str,
    algorithm: str,
    colours: Colours = "fixed",
    task: Task = "reach",
) -> str:
    """Return the name of an experiment; the choice task always randomizes the colours."""
    suffix = next(suffix for suffix, value in COLOURS.items() if value == colours)
    if task == "choose":
        return f"{robot}-choose-{agent}-{algorithm}"
    return f"{robot}-{agent}{suffix}-{algorithm}"


DEFAULT_EXPERIMENT = experiment_name(
    next(iter(ROBOTS)), first_of_role("knowledge"), next(iter(ALGORITHMS))
)
"""Experiment of the benchmarks, the installation check and the examples."""


def experiment_names() -> list[str]:
    """List the names of all experiments that the registries define now."""
    return [experiment_name(*parts) for parts in _combinations()]


def experiment_config(name: str, **overrides: Any) -> ExperimentConfig:
    """Return the config of a named experiment.

    Args:
        name: ``<robot>-<agent>[-dr]-<algorithm>``.
        **overrides: fields to change; a nested config takes a mapping of its fields, such as
            ``algorithm={"num_envs": 64}``.

    Raises:
        UserError: there is no experiment of that name (the message lists the nearest names), or an
            override does not fit.
    """
    for parts in _combinations():
        if name == experiment_name(*parts):
            config = _config(name, *parts)
            return replace(config, overrides) if overrides else config
    robot = max((each for each in ROBOTS if name.startswith(f"{each}-")), key=len, default=None)
    if robot is None:
        raise unknown_name("robot of the experiment", name.partition("-")[0], ROBOTS)
    middle, _, algorithm = name.removeprefix(f"{robot}-").rpartition("-")
    if algorithm not in ALGORITHMS:
        raise unknown_name("experiment", name, experiment_names())
    task: Task = "choose" if middle.startswith("choose-") else "reach"
    given = middle.removeprefix("choose-").removesuffix("-dr")
    known = [each for each, agent in AGENTS.items() if task in tasks_of(agent)]
    raise unknown_name("agent of the experiment", given, known)


def tasks_of(agent: Agent) -> tuple[Task, ...]:
    """Return the tasks in which an agent is an experiment.

    An agent that is told the query needs a task that asks; one that is told the target or the
    scene has no meaning there. What is perceived can be told in both.
    """
    if agent.marked or agent.knowledge.scope == "query":
        return ("choose",)
    # One-hot codes have fewer numbers than the choice task has facets.
    perceives = agent.knowledge.scope == "perceived" and agent.knowledge.source != OneHot()
    both = agent.role == "baseline" or perceives
    return ("reach", "choose") if both else ("reach",)


def _combinations() -> Iterator[tuple[str, str, str, Colours, Task]]:
    for robot, entry in ROBOTS.items():
        for name, agent in AGENTS.items():
            tasks = tasks_of(agent)
            for colours in COLOURS.values():
                for algorithm in ALGORITHMS:
                    if "reach" in tasks:
                        yield robot, name, algorithm, colours, "reach"
            for algorithm in ALGORITHMS:
                if "choose" in tasks and entry.choice_env_id is not None:
                    yield robot, name, algorithm, "randomized", "choose"


def _config(
    name: str, robot: str, agent_name: str, algorithm_name: str, colours: Colours, task: Task
) -> ExperimentConfig:
    agent, algorithm = AGENTS[agent_name], ALGORITHMS[algorithm_name]
    env, knowledge = EnvConfig(robot=robot, colours=colours), agent.knowledge
    if task == "choose":
        choice = ChoiceConfig(queries=GraphQueries(), marked=agent.marked)
        env = choice_env_config(robot, choice=choice)
        if knowledge.scope == "perceived":  # described by the graph that is asked
            knowledge = dataclasses.replace(knowledge, graph=QUERY.graph, aliases=QUERY.aliases)
    config = ExperimentConfig(
        name=name,
        agent=agent_name,
        role=agent.role,
        total_steps=algorithm.total_steps,
        env=env,
        knowledge=knowledge,
        policy=dataclasses.replace(agent.policy, **algorithm.policy),
        grounding=agent.grounding,
        algorithm=algorithm.config,
    )
    return replace(config, algorithm.choice) if task == "choose" else config
