"""Benchmark of simulation with images on this machine's CPU (`knowarm bench world`)."""

import os
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import gymnasium
import numpy as np

from knowarm.bench.clock import cpu_seconds
from knowarm.cores import processor
from knowarm.errors import UserError
from knowarm.world.config import EnvConfig, choice_env_config
from knowarm.world.robots import MAIN_ROBOTS
from knowarm.world.tasks.reach import ACTION_LEVELS
from knowarm.world.vector_env import ReachVectorEnv

DYNAMICS: tuple[Literal["dynamic", "kinematic"], ...] = ("dynamic", "kinematic")
"""Kinds of dynamics to measure."""

SCALING_ENVS = (1, 4, 16, 64, 256, 1024, 4096)
"""Numbers of environments of the scaling table."""

SCALING_PIXELS = (32, 128, 256)
"""Image sizes of the scaling table [px], beside the configured one."""


class Speed(NamedTuple):
    """Speed of a vector environment."""

    steps_per_s: float
    """Environment steps per second by the clock."""

    steps_per_cpu_s: float
    """Environment steps per second of CPU time, summed over processes and threads."""


@dataclass(frozen=True, kw_only=True)
class WorldBenchConfig:
    """Settings of the simulation benchmark."""

    workers: int = 2
    """Threads of the environment."""

    num_envs: int = 256
    """Number of parallel environments."""

    seconds: float = 5.0
    """Measuring time per row [s]."""

    robots: tuple[str, ...] = MAIN_ROBOTS
    """Robots to measure."""

    image_size: int = 64
    """Side length of the images [px]."""

    scaling: bool = True
    """Also measure the first robot with 1 to 4,096 environments and 32 to 256 pixels."""

    def __post_init__(self) -> None:
        for name in ("workers", "num_envs", "image_size"):
            if getattr(self, name) < 1:
                raise UserError(f"{name} must be at least 1, got {getattr(self, name)}.")


def bench_world(
    config: WorldBenchConfig | None = None,
    on_row: Callable[[dict[str, Any]], None] = lambda row: None,
) -> dict[str, Any]:
    """Measure environment steps per second, physics and image included.

    Args:
        config: what to measure.
        on_row: called with each row of ``rows`` as soon as it is measured.

    Returns:
        ``rows``: steps per second by robot, task and dynamics, by the clock and by CPU time.
        ``raycaster``: frames per second of one core, by robot and anti-aliasing.
        ``scaling``: steps per second by number of environments and by image size.
        ``machine`` and ``config``.
    """
    config = config or WorldBenchConfig()
    rows = []
    for env_config in env_configs(config):
        task = "choose" if env_config.choice else "reach"
        row = {"robot": env_config.robot, "task": task, "dynamics": env_config.dynamics}
        row |= measure_env(env_config, config.num_envs, config.workers, config.seconds)._asdict()
        on_row(row)
        rows.append(row)
    return {
        "rows": rows,
        "raycaster": [
            {
                "robot": robot,
                "antialiasing": antialiasing,
                "frames_per_s_core": measure_raycaster(
                    EnvConfig(robot=robot, antialiasing=antialiasing, image_size=config.image_size),
                    num_envs=config.num_envs,
                    seconds=config.seconds / 2,
                ),
            }
            for robot in config.robots
            for antialiasing in (False, True)
        ],
        "scaling": _scaling(config) if config.scaling else [],
        "machine": {"processor": processor(), "cpus": os.cpu_count()},
        "config": {name: getattr(config, name) for name in ("workers", "num_envs", "seconds")},
    }


def env_configs(config: WorldBenchConfig) -> list[EnvConfig]:
    """Return a config for each robot and kind of dynamics, and the choice task of each robot."""
    configs = []
    for robot in config.robots:
        configs += [
            EnvConfig(robot=robot, dynamics=dynamics, image_size=config.image_size)
            for dynamics in DYNAMICS
        ]
        configs.append(choice_env_config(robot, image_size=config.image_size))
    return configs


def measure_env(config: EnvConfig, num_envs: int, threads: int, seconds: float) -> Speed:
    """Measure KnowArm's vector environment with random actions."""
    return measure_steps(ReachVectorEnv(config, num_envs, threads), seconds)


def measure_steps(env: gymnasium.vector.VectorEnv, seconds: float) -> Speed:
    """Measure any vector environment with random actions, after three warm-up steps.

    Args:
        env: environment with actions ``MultiDiscrete([levels] * joints)``.
        seconds: measuring time [s].
    """
    env.reset(seed=0)
    generator = np.random.default_rng(0)
    joints = env.single_action_space.shape
    assert joints is not None
    actions = generator.integers(len(ACTION_LEVELS), size=(64, env.num_envs, *joints))
    for i in range(3):
        env.step(actions[i])
    count, start, cpu = 0, time.perf_counter(), cpu_seconds()
    while (elapsed := time.perf_counter() - start) < seconds or count == 0:
        env.step(actions[count % 64])
        count += 1
    steps = count * env.num_envs
    return Speed(steps / elapsed, steps / (cpu_seconds() - cpu))


def measure_raycaster(config: EnvConfig, *, num_envs: int, seconds: float) -> float:
    """Measure the ray caster alone on one core, rendering the same states repeatedly.

    Args:
        config: robot, image size and anti-aliasing.
        num_envs: images per call.
        seconds: measuring time [s].

    Returns:
        Frames per second of CPU time.
    """
    env = ReachVectorEnv(config, num_envs, num_threads=1)
    env.reset(seed=0)
    poses = env.simulation.geom_position, env.simulation.geom_matrix, env.geom_rgba
    env.renderer.draw(*poses)
    count, start, cpu = 0, time.perf_counter(), cpu_seconds()
    while time.perf_counter() - start < seconds or count == 0:
        env.renderer.draw(*poses)
        count += 1
    return count * num_envs / (cpu_seconds() - cpu)


def _scaling(bench: WorldBenchConfig) -> list[dict[str, Any]]:
    """Measure the first robot with other numbers of environments and other image sizes."""
    base = EnvConfig(robot=bench.robots[0], image_size=bench.image_size)
    sizes = [(num_envs, bench.image_size) for num_envs in SCALING_ENVS]
    sizes += [(bench.num_envs, pixels) for pixels in SCALING_PIXELS]
    rows = []
    for num_envs, pixels in sizes:
        config = replace(base, image_size=pixels)
        speed = measure_env(config, num_envs, bench.workers, bench.seconds / 2)
        rows.append({"num_envs": num_envs, "image_size": pixels} | speed._asdict())
    return rows
