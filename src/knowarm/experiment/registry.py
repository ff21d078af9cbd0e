"""A name goes in; the experiment it stands for comes out.

Names are ``<robot>-<agent>[-dr]-<algorithm>``: ``irb120-full-ppo``, ``tiago-bm-dr-a3c``; ``dr``
randomizes the targets' colours (paper section 4.2.5).
"""

from dataclasses import replace
from typing import Literal

from knowarm.errors import unknown_name
from knowarm.experiment.agents import AGENTS
from knowarm.experiment.config import Algorithm, ExperimentConfig
from knowarm.learn.config import A3CConfig, PPOConfig
from knowarm.world.config import EnvConfig
from knowarm.world.robots import ROBOTS

ALGORITHMS: dict[str, Algorithm] = {"ppo": PPOConfig(), "a3c": A3CConfig()}
"""Each algorithm with the numbers an experiment of that name starts from."""

PIXELS = {"ppo": (0.5, 4.0), "a3c": (0.0, 1.0)}
"""Shift and scale of the pixels by algorithm: A3C gets them as the paper does, 0 to 1."""

TOTAL_STEPS = {"ppo": 10_000_000, "a3c": 70_000_000}
"""Environment steps by algorithm: A3C's is the paper's."""


COLOURS: dict[str, Literal["fixed", "randomized"]] = {"": "fixed", "-dr": "randomized"}
"""What a name's suffix says about the targets' colours."""


def _experiments() -> dict[str, ExperimentConfig]:
    experiments = {}
    for robot in ROBOTS:
        for agent, choices in AGENTS.items():
            for suffix, colours in COLOURS.items():
                for algorithm, numbers in ALGORITHMS.items():
                    shift, scale = PIXELS[algorithm]
                    name = f"{robot}-{agent}{suffix}-{algorithm}"
                    experiments[name] = ExperimentConfig(
                        name=name,
                        agent=agent,
                        total_steps=TOTAL_STEPS[algorithm],
                        env=EnvConfig(robot=robot, colours=colours),
                        knowledge=choices.knowledge,
                        network=replace(choices.network, pixel_shift=shift, pixel_scale=scale),
                        algorithm=numbers,
                    )
    return experiments


EXPERIMENTS = _experiments()
"""Every named experiment."""

DEFAULT_EXPERIMENT = "irb120-full-ppo"
"""Experiment of the benchmarks, of the installation check and of examples."""


def experiment(name: str) -> ExperimentConfig:
    """Look an experiment up.

    Raises:
        UserError: there is none of that name; the message offers the nearest.
    """
    if name not in EXPERIMENTS:
        robot, _, rest = name.partition("-")
        if robot not in ROBOTS:
            raise unknown_name("robot of the experiment", robot, ROBOTS)
        middle, _, algorithm = rest.rpartition("-")
        if algorithm not in ALGORITHMS:
            raise unknown_name("experiment", name, EXPERIMENTS)
        raise unknown_name("agent of the experiment", middle.removesuffix("-dr"), AGENTS)
    return EXPERIMENTS[name]
