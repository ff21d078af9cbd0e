"""Nothing but this machine goes in; speeds of our worlds and of others' come out."""

import multiprocessing
import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium.vector import AsyncVectorEnv, AutoresetMode

from knowarm.bench.mjwarp_pictures import MjWarpPictures
from knowarm.errors import UserError
from knowarm.world import ENV_IDS
from knowarm.world.env import ACTION_LEVELS, EnvConfig, ReachVectorEnv

DYNAMICS: tuple[Literal["dynamic", "kinematic"], ...] = ("dynamic", "kinematic")


@dataclass(frozen=True, kw_only=True)
class WorldBenchConfig:
    """What is measured, and for how long."""

    workers: int = 2
    """Threads or processes everybody may use."""

    num_envs: int = 256
    """Environments of the batched worlds; AsyncVectorEnv has one a worker, more only wait."""

    seconds: float = 5.0
    """Time each row is measured for."""

    robots: tuple[str, ...] = ("irb120", "tiago")
    """Robots measured."""

    image_size: int = 64
    """Side of the pictures [px]."""

    opengl: bool = True
    """Measure AsyncVectorEnv with MuJoCo's OpenGL renderer (needs OSMesa or EGL)."""

    mjwarp: bool = True
    """Measure MuJoCo Warp's ray caster (needs the packages mujoco-warp and warp-lang)."""

    growth: bool = True
    """Measure ours with 1 to 4,096 environments and 32 to 256 pixels."""

    def __post_init__(self) -> None:
        for name in ("workers", "num_envs", "image_size"):
            if getattr(self, name) < 1:
                raise UserError(f"{name} must be at least 1, got {getattr(self, name)}.")
        if self.num_envs % self.workers:
            raise UserError(
                f"num_envs ({self.num_envs}) must be a multiple of workers ({self.workers})."
            )


def bench_world(
    config: WorldBenchConfig | None = None,
    on_row: Callable[[dict[str, Any]], None] = lambda r: None,
) -> dict[str, Any]:
    """Measure environment steps per second, physics and picture, one row after the other.

    Args:
        config: what is measured.
        on_row: called with each row as it is measured.

    Returns:
        ``rows``: robot, dynamics, steps_per_s of ours, opengl and mjwarp, ratio_vs_opengl and
        ratio_vs_mjwarp. ``raycaster``: frames_per_s a core by robot and anti-aliasing. ``growth``:
        ours by number of environments and by image size. ``machine`` and ``config``.

    Raises:
        UserError: a row needs what is not installed.
    """
    config = config or WorldBenchConfig()
    rows = []
    for robot in config.robots:
        for dynamics in DYNAMICS:
            env_config = EnvConfig(robot=robot, dynamics=dynamics, image_size=config.image_size)
            row: dict[str, Any] = {"robot": robot, "dynamics": dynamics}
            row["steps_per_s"] = _ours(env_config, config.num_envs, config.workers, config.seconds)
            if config.opengl:
                row["opengl_steps_per_s"] = _async_opengl(env_config, config)
                row["ratio_vs_opengl"] = row["steps_per_s"] / row["opengl_steps_per_s"]
            if config.mjwarp:
                row["mjwarp_steps_per_s"] = _mjwarp(env_config, config)
                row["ratio_vs_mjwarp"] = row["steps_per_s"] / row["mjwarp_steps_per_s"]
            on_row(row)
            rows.append(row)
    return {
        "rows": rows,
        "raycaster": [
            {
                "robot": robot,
                "antialiasing": antialiasing,
                "frames_per_s_core": _frames_per_s(
                    EnvConfig(robot=robot, antialiasing=antialiasing, image_size=config.image_size),
                    config,
                ),
            }
            for robot in config.robots
            for antialiasing in (False, True)
        ],
        "growth": _growth(config) if config.growth else [],
        "machine": {
            "processor": platform.processor() or platform.machine(),
            "cpus": os.cpu_count(),
        },
        "config": {name: getattr(config, name) for name in ("workers", "num_envs", "seconds")},
    }


def _steps_per_s(env: gymnasium.vector.VectorEnv, seconds: float) -> float:
    """Step with random actions for a while, after one episode that warms everything up."""
    env.reset(seed=0)
    generator = np.random.default_rng(0)
    joints = env.single_action_space.shape
    assert joints is not None
    actions = generator.integers(len(ACTION_LEVELS), size=(64, env.num_envs, *joints))
    for i in range(3):
        env.step(actions[i])
    count, start = 0, time.perf_counter()
    while (elapsed := time.perf_counter() - start) < seconds:
        env.step(actions[count % 64])
        count += 1
    return count * env.num_envs / elapsed


def _ours(config: EnvConfig, num_envs: int, threads: int, seconds: float) -> float:
    return _steps_per_s(ReachVectorEnv(config, num_envs, threads), seconds)


def _async_opengl(config: EnvConfig, bench: WorldBenchConfig) -> float:
    """Gymnasium's AsyncVectorEnv: a process a worker, each a single environment with OpenGL."""
    env_id = {robot: env_id for env_id, robot in ENV_IDS.items()}[config.robot]
    options: dict[str, Any] = {
        "dynamics": config.dynamics,
        "image_size": config.image_size,
        "renderer": "opengl",
    }
    env = AsyncVectorEnv(
        [lambda: gymnasium.make(env_id, disable_env_checker=True, **options)] * bench.workers,
        autoreset_mode=AutoresetMode.SAME_STEP,
        context="spawn",
    )
    try:
        return _steps_per_s(env, bench.seconds)
    finally:
        env.close()


def _mjwarp(config: EnvConfig, bench: WorldBenchConfig) -> float:
    """Our environment on MuJoCo's batch, drawn by MuJoCo Warp: a process a worker."""
    context = multiprocessing.get_context("spawn")
    share = bench.num_envs // bench.workers
    barrier = context.Barrier(bench.workers)
    with context.Pool(bench.workers, _remember, (barrier,)) as pool:
        tasks = [(config, share, bench.seconds)] * bench.workers
        return float(sum(pool.starmap(_mjwarp_worker, tasks, chunksize=1)))


_barrier: Any = None


def _remember(barrier: Any) -> None:
    """Keep the barrier that lets the workers of a pool begin together."""
    global _barrier
    _barrier = barrier


def _mjwarp_worker(config: EnvConfig, num_envs: int, seconds: float) -> float:
    env = ReachVectorEnv(config, num_envs, num_threads=1)
    env.pictures = MjWarpPictures(env.scene, config.image_size, num_envs)
    env.reset(seed=0)  # compiles Warp's kernels, before anybody's time is taken
    _barrier.wait()
    return _steps_per_s(env, seconds)


def _frames_per_s(config: EnvConfig, bench: WorldBenchConfig) -> float:
    """Our ray caster alone, one core: the same states again and again."""
    env = ReachVectorEnv(config, bench.num_envs, num_threads=1)
    env.reset(seed=0)
    poses = env.simulation.geom_position, env.simulation.geom_matrix, env.geom_rgba
    env.pictures.draw(*poses)
    count, start = 0, time.perf_counter()
    while (elapsed := time.perf_counter() - start) < bench.seconds / 2:
        env.pictures.draw(*poses)
        count += 1
    return count * bench.num_envs / elapsed


def _growth(bench: WorldBenchConfig) -> list[dict[str, Any]]:
    """Ours on the first robot, with more environments and with more pixels."""
    base = EnvConfig(robot=bench.robots[0], image_size=bench.image_size)
    sizes = [(num_envs, bench.image_size) for num_envs in (1, 4, 16, 64, 256, 1024, 4096)]
    sizes += [(bench.num_envs, pixels) for pixels in (32, 128, 256)]
    return [
        {
            "num_envs": num_envs,
            "image_size": pixels,
            "steps_per_s": _ours(
                replace(base, image_size=pixels), num_envs, bench.workers, bench.seconds / 2
            ),
        }
        for num_envs, pixels in sizes
    ]
