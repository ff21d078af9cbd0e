"""Speed of simulation with images on the CPU, by robot, task, dynamics, batch and image size.

python -m benchmarks.world --json runs/bench/world.json
"""

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import tyro

from benchmarks.speed import Speed, measure_images, measure_steps
from knowarm.cli.tables import check_output, print_table, write_json_table
from knowarm.cores import processor
from knowarm.errors import UserError
from knowarm.world.config import EnvConfig
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.robots import ROBOTS
from knowarm.world.tasks import find_task

DYNAMICS: tuple[Literal["dynamic", "kinematic"], ...] = ("dynamic", "kinematic")
"""Kinds of dynamics to measure."""

SCALING_ENVS = (1, 4, 16, 64, 256, 1024, 4096)
"""Numbers of environments of the scaling table."""

SCALING_PIXELS = (32, 128, 256)
"""Image sizes of the scaling table [px], beside the configured one."""


@dataclass(frozen=True, kw_only=True)
class WorldBenchConfig:
    """Settings of the simulation benchmark."""

    workers: int = 2
    """Threads of the environment."""

    num_envs: int = 256
    """Number of parallel environments."""

    seconds: float = 5.0
    """Measuring time per row [s]."""

    robots: tuple[str, ...] = tuple(ROBOTS)
    """Robots to measure."""

    image_size: int = 64
    """Side length of the images [px]."""

    scaling: bool = True
    """Also measure the first robot with 1 to 4,096 environments and 32 to 256 pixels."""

    json: Path | None = None
    """Also write the tables to this JSON file."""

    def __post_init__(self) -> None:
        for name in ("workers", "num_envs", "image_size"):
            if getattr(self, name) < 1:
                raise UserError(
                    f"{name} must be at least 1, got {getattr(self, name)}."
                )


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
        task = env_config.task.name
        row = {"robot": env_config.robot, "task": task, "dynamics": env_config.dynamics}
        row |= measure_env(
            env_config, config.num_envs, config.workers, config.seconds
        )._asdict()
        on_row(row)
        rows.append(row)
    return {
        "rows": rows,
        "raycaster": [
            {
                "robot": robot,
                "antialiasing": antialiasing,
                "frames_per_s_core": measure_images(
                    EnvConfig(
                        robot=robot,
                        antialiasing=antialiasing,
                        image_size=config.image_size,
                    ),
                    num_envs=config.num_envs,
                    seconds=config.seconds / 2,
                ),
            }
            for robot in config.robots
            for antialiasing in (False, True)
        ],
        "scaling": _scaling(config) if config.scaling else [],
        "machine": {"processor": processor(), "cpus": os.cpu_count()},
        "config": {
            name: getattr(config, name) for name in ("workers", "num_envs", "seconds")
        },
    }


def env_configs(config: WorldBenchConfig) -> list[EnvConfig]:
    """Return a config for each robot and kind of dynamics, and the choice task of each robot."""
    configs = []
    for robot in config.robots:
        configs += [
            EnvConfig(robot=robot, dynamics=dynamics, image_size=config.image_size)
            for dynamics in DYNAMICS
        ]
        configs.append(
            EnvConfig(
                robot=robot, task=find_task("choose"), image_size=config.image_size
            )
        )
    return configs


def measure_env(
    config: EnvConfig, num_envs: int, threads: int, seconds: float
) -> Speed:
    """Measure KnowArm's vector environment with random actions."""
    return measure_steps(ArmVectorEnv(config, num_envs, threads), seconds)


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


TABLES = {
    "rows": "Environment steps/s with images, all threads together",
    "raycaster": "Ray caster alone",
    "scaling": "Scaling with the number of environments and the image size",
}
"""Titles of the tables, by field of the result."""


def main() -> None:
    config = tyro.cli(WorldBenchConfig, description=__doc__)
    check_output(config.json)
    result = bench_world(config)
    for name, title in TABLES.items():
        if rows := result[name]:
            print_table(title, list(rows[0]), [list(row.values()) for row in rows])
    write_json_table(config.json, result)


if __name__ == "__main__":
    main()
