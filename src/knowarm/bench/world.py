"""Nothing but this machine goes in; speeds of our worlds and of others' come out."""

import multiprocessing
import os
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import gymnasium
import numpy as np
import psutil
from gymnasium.vector import AsyncVectorEnv, AutoresetMode

from knowarm.bench.mjwarp_renderer import MjWarpRenderer
from knowarm.errors import UserError
from knowarm.cores import processor
from knowarm.world import env_id
from knowarm.world.config import EnvConfig
from knowarm.world.tasks.reach import ACTION_LEVELS
from knowarm.world.vector_env import ReachVectorEnv

DYNAMICS: tuple[Literal["dynamic", "kinematic"], ...] = ("dynamic", "kinematic")


class Speed(NamedTuple):
    """How fast something steps."""

    steps_per_s: float
    """Environment steps a second on the clock."""

    steps_per_cpu_s: float
    """Environment steps a second of CPU time, all processes and threads together."""


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
    """Side of the images [px]."""

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
    """Measure environment steps per second, physics and image, one row after the other.

    Args:
        config: what is measured.
        on_row: called with each row as it is measured.

    Returns:
        ``rows``: robot, dynamics, steps_per_s of ours, opengl and mjwarp, ratio_vs_opengl and
        ratio_vs_mjwarp, and the same by CPU time, which neighbours on a shared machine disturb
        less. ``raycaster``: frames_per_s a core by robot and anti-aliasing. ``growth``: ours by
        number of environments and by image size. ``machine`` and ``config``.

    Raises:
        UserError: a row needs what is not installed.
    """
    config = config or WorldBenchConfig()
    rows = []
    for robot in config.robots:
        for dynamics in DYNAMICS:
            env_config = EnvConfig(robot=robot, dynamics=dynamics, image_size=config.image_size)
            row: dict[str, Any] = {"robot": robot, "dynamics": dynamics}
            ours = _ours(env_config, config.num_envs, config.workers, config.seconds)
            row |= ours._asdict()
            others: dict[str, Callable[[EnvConfig, WorldBenchConfig], Speed]] = {}
            if config.opengl:
                others["opengl"] = _async_opengl
            if config.mjwarp:
                others["mjwarp"] = _mjwarp
            for name, measure in others.items():
                theirs = measure(env_config, config)
                row |= {f"{name}_{key}": value for key, value in theirs._asdict().items()}
                row[f"ratio_vs_{name}"] = ours.steps_per_s / theirs.steps_per_s
                row[f"cpu_ratio_vs_{name}"] = ours.steps_per_cpu_s / theirs.steps_per_cpu_s
            on_row(row)
            rows.append(row)
    return {
        "rows": rows,
        "raycaster": [
            {
                "robot": robot,
                "antialiasing": antialiasing,
                "frames_per_s_core": frames_per_core_s(
                    EnvConfig(robot=robot, antialiasing=antialiasing, image_size=config.image_size),
                    num_envs=config.num_envs,
                    seconds=config.seconds,
                ),
            }
            for robot in config.robots
            for antialiasing in (False, True)
        ],
        "growth": _growth(config) if config.growth else [],
        "machine": {
            "processor": processor(),
            "cpus": os.cpu_count(),
        },
        "config": {name: getattr(config, name) for name in ("workers", "num_envs", "seconds")},
    }


def _steps_per_s(env: gymnasium.vector.VectorEnv, seconds: float) -> Speed:
    """Step with random actions for a while, after a few steps that warm everything up."""
    env.reset(seed=0)
    generator = np.random.default_rng(0)
    joints = env.single_action_space.shape
    assert joints is not None
    actions = generator.integers(len(ACTION_LEVELS), size=(64, env.num_envs, *joints))
    for i in range(3):
        env.step(actions[i])
    count, start, cpu = 0, time.perf_counter(), _cpu_s()
    while (elapsed := time.perf_counter() - start) < seconds:
        env.step(actions[count % 64])
        count += 1
    steps = count * env.num_envs
    return Speed(steps / elapsed, steps / (_cpu_s() - cpu))


def _cpu_s() -> float:
    """CPU time used so far by this process and those it started [s]."""
    # The system counts other processes' time in ticks of 10 ms: a short measurement may see none.
    children = psutil.Process().children(recursive=True)
    return time.process_time() + sum(sum(child.cpu_times()[:2]) for child in children)


def _ours(config: EnvConfig, num_envs: int, threads: int, seconds: float) -> Speed:
    return _steps_per_s(ReachVectorEnv(config, num_envs, threads), seconds)


def _async_opengl(config: EnvConfig, bench: WorldBenchConfig) -> Speed:
    """Measure AsyncVectorEnv from a process of its own: MuJoCo picks its OpenGL when imported."""
    os.environ.setdefault("MUJOCO_GL", "egl")
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        return pool.submit(_async_worker, config, bench).result()


def _async_worker(config: EnvConfig, bench: WorldBenchConfig) -> Speed:
    """Gymnasium's AsyncVectorEnv: a process a worker, each a single environment with OpenGL."""
    # The prefix makes Gymnasium import the package in each worker, which registers the id.
    name = f"knowarm:{env_id(config.robot)}"
    options: dict[str, Any] = {
        "dynamics": config.dynamics,
        "image_size": config.image_size,
        "renderer": "opengl",
    }
    env = AsyncVectorEnv(
        [lambda: gymnasium.make(name, disable_env_checker=True, **options)] * bench.workers,
        autoreset_mode=AutoresetMode.SAME_STEP,
        context="spawn",
    )
    try:
        return _steps_per_s(env, bench.seconds)
    finally:
        env.close()


def _mjwarp(config: EnvConfig, bench: WorldBenchConfig) -> Speed:
    """Our environment on MuJoCo's batch, drawn by MuJoCo Warp: a process a worker."""
    context = multiprocessing.get_context("spawn")
    share = bench.num_envs // bench.workers
    barrier = context.Barrier(bench.workers)
    with context.Pool(bench.workers, _remember, (barrier,)) as pool:
        tasks = [(config, share, bench.seconds)] * bench.workers
        speeds = pool.starmap(_mjwarp_worker, tasks, chunksize=1)
    return Speed(
        sum(speed.steps_per_s for speed in speeds),
        float(np.mean([speed.steps_per_cpu_s for speed in speeds])),
    )


_barrier: Any = None


def _remember(barrier: Any) -> None:
    """Keep the barrier that lets the workers of a pool begin together."""
    global _barrier
    _barrier = barrier


def _mjwarp_worker(config: EnvConfig, num_envs: int, seconds: float) -> Speed:
    env = ReachVectorEnv(config, num_envs, num_threads=1)
    env.renderer = MjWarpRenderer(env.scene, config.image_size, num_envs)
    env.reset(seed=0)  # compiles Warp's kernels, before anybody's time is taken
    _barrier.wait()
    return _steps_per_s(env, seconds)


def frames_per_core_s(config: EnvConfig, *, num_envs: int, seconds: float) -> float:
    """Our ray caster alone, frames a second of CPU time: the same states again and again."""
    env = ReachVectorEnv(config, num_envs, num_threads=1)
    env.reset(seed=0)
    poses = env.simulation.geom_position, env.simulation.geom_matrix, env.geom_rgba
    env.renderer.draw(*poses)
    count, start, cpu = 0, time.perf_counter(), _cpu_s()
    while time.perf_counter() - start < seconds / 2:
        env.renderer.draw(*poses)
        count += 1
    return count * num_envs / (_cpu_s() - cpu)


def _growth(bench: WorldBenchConfig) -> list[dict[str, Any]]:
    """Ours on the first robot, with more environments and with more pixels."""
    base = EnvConfig(robot=bench.robots[0], image_size=bench.image_size)
    sizes = [(num_envs, bench.image_size) for num_envs in (1, 4, 16, 64, 256, 1024, 4096)]
    sizes += [(bench.num_envs, pixels) for pixels in (32, 128, 256)]
    return [
        {
            "num_envs": num_envs,
            "image_size": pixels,
        }
        | _ours(
            replace(base, image_size=pixels), num_envs, bench.workers, bench.seconds / 2
        )._asdict()
        for num_envs, pixels in sizes
    ]
