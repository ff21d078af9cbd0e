"""Named experiments: every combination of robot, agent, target colours and algorithm.

Names are ``<robot>-<agent>[-dr]-<algorithm>``, such as ``irb120-full-ppo`` or ``tiago-bm-dr-a3c``;
``dr`` randomizes the targets' colours (paper section 4.2.5).
"""

import dataclasses
from collections.abc import Iterator
from typing import Any, Literal

from knowarm.config import replace
from knowarm.errors import unknown_name
from knowarm.experiment.agents import AGENTS, first_of_role
from knowarm.experiment.algorithms import ALGORITHMS
from knowarm.experiment.config import ExperimentConfig
from knowarm.world.config import EnvConfig
from knowarm.world.robots import ROBOTS

Colours = Literal["fixed", "randomized"]

COLOURS: dict[str, Colours] = {"": "fixed", "-dr": "randomized"}
"""Colours of the targets by the suffix of the agent in an experiment's name."""


def experiment_name(robot: str, agent: str, algorithm: str, colours: Colours = "fixed") -> str:
    """Return the name of an experiment."""
    suffix = next(suffix for suffix, value in COLOURS.items() if value == colours)
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
    known = dict.fromkeys(parts[1] for parts in _combinations())
    raise unknown_name("agent of the experiment", middle.removesuffix("-dr"), known)


def _combinations() -> Iterator[tuple[str, str, str, Colours]]:
    for robot in ROBOTS:
        for agent, entry in AGENTS.items():
            if entry.knowledge.scope == "query":  # reaching shows one object and asks nothing
                continue
            for colours in COLOURS.values():
                for algorithm in ALGORITHMS:
                    yield robot, agent, algorithm, colours


def _config(
    name: str, robot: str, agent_name: str, algorithm_name: str, colours: Colours
) -> ExperimentConfig:
    agent, algorithm = AGENTS[agent_name], ALGORITHMS[algorithm_name]
    return ExperimentConfig(
        name=name,
        agent=agent_name,
        role=agent.role,
        total_steps=algorithm.total_steps,
        env=EnvConfig(robot=robot, colours=colours),
        knowledge=agent.knowledge,
        policy=dataclasses.replace(agent.policy, **algorithm.policy),
        algorithm=algorithm.config,
    )
