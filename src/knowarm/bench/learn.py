"""Nothing but this machine goes in; training speed of our learners and of sb3-contrib's comes out.

Every row trains the experiment ``<robot>-full``: physics, image, policy and update.
"""

import os
import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from knowarm.bench.world import frames_per_core_s
from knowarm.errors import UserError
from knowarm.cores import processor
from knowarm.experiment.build import EnvFactory, build
from knowarm.experiment.registry import experiment_config
from knowarm.learn import A3CConfig, A3CTrainer, Hooks, Metrics, NumpyToTorch, PPOConfig, PPOTrainer
from knowarm.world.knowledge_observation import VectorKnowledgeObservation
from knowarm.world.vector_env import ReachVectorEnv

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecEnv

WARM_UP_UPDATES = 2
"""Updates that are not counted: the first ones compile and fill caches."""


@dataclass(frozen=True, kw_only=True)
class BenchConfig:
    """What is measured, and for how long."""

    robot: str = "irb120"
    """Robot of the experiment ``<robot>-full``."""

    cores: int = 2
    """Threads or processes everybody may use."""

    seconds: float = 15.0
    """Time each row is measured for, at least."""

    turns: int = 3
    """Times our PPO and sb3-contrib's are measured, one after the other."""

    epochs: int = 3
    """Passes over a rollout, ours and theirs; 3 is what the target of 2,500 steps/s is set for."""

    opengl_envs: int = 8
    """Single environments with MuJoCo's OpenGL renderer; more do not make them faster."""

    opengl: bool = True
    """Whether the OpenGL row is measured; it needs EGL or OSMesa."""

    seed: int = 0
    """Seed of everything."""


def bench_learn(config: BenchConfig | None = None) -> dict[str, Any]:
    """Measure environment steps per second of training, row after row.

    Returns:
        ``rows`` (name, envs, steps_per_s, shares of the time where known; the ray caster's alone
        are frames of one core), ``steps_per_s`` of our PPO, ``ratio_vs_sb3`` (RecurrentPPO on our
        vector environment, same sizes, epochs and minibatches), ``ratio_vs_sb3_opengl``
        (RecurrentPPO on single environments with MuJoCo's renderer; None if left out),
        ``ratio_a3c_batched`` (A3C with many environments a worker over the paper's 17 x 1), and
        what it was measured on.

    Raises:
        UserError: the packages of ``pip install 'knowarm[sb3]'`` are missing.
    """
    config = config or BenchConfig()
    # The single environments' processes read it when they start.
    os.environ.setdefault("MUJOCO_GL", "egl")
    torch.set_num_threads(config.cores)
    # In turns, since a machine is not equally fast at all times; the middle turn of each counts.
    turns = [(_ppo(config), _sb3(config, opengl=False)) for _ in range(config.turns)]
    ppo, sb3 = (sorted(rows, key=_speed)[len(rows) // 2] for rows in zip(*turns, strict=True))
    rows = [_raycaster(config), ppo, _a3c(config, 17, 1), _a3c(config, config.cores, 128), sb3]
    if config.opengl:
        rows.append(_sb3(config, opengl=True))
    speed = {row["name"]: row["steps_per_s"] for row in rows}
    ours, theirs_opengl = speed["ppo"], speed.get("sb3-opengl")
    return {
        "experiment": f"{config.robot}-full",
        "cores": config.cores,
        "epochs": config.epochs,
        "machine": f"{processor()}, {os.cpu_count()} cores",
        "torch": torch.__version__,
        "rows": rows,
        "steps_per_s": ours,
        "ratio_vs_sb3": ours / speed["sb3"],
        "ratio_vs_sb3_opengl": ours / theirs_opengl if theirs_opengl else None,
        "ratio_a3c_batched": speed["a3c-batched"] / speed["a3c"],
    }


def _speed(row: dict[str, Any]) -> float:
    return float(row["steps_per_s"])


def _raycaster(config: BenchConfig) -> dict[str, Any]:
    """The ray caster alone on one core, as training uses it: how fast this machine is."""
    chosen = experiment_config(f"{config.robot}-full-ppo")
    frames_per_s = frames_per_core_s(chosen.env, num_envs=128, seconds=config.seconds)
    return {
        "name": "raycaster",
        "what": "KnowArm's ray caster alone, frames of one core",
        "envs": 128,
        "steps_per_s": frames_per_s,
    }


def _ppo(config: BenchConfig) -> dict[str, Any]:
    """Our recurrent PPO."""
    chosen = experiment_config(f"{config.robot}-full-ppo")
    parts = build(chosen)
    numbers = _ppo_numbers(config)
    env = ReachVectorEnv(chosen.env, numbers.num_envs, num_threads=config.cores)
    drawing = _DrawingClock(env)
    rows: list[Metrics] = []
    drawn: list[float] = []

    def note(row: Metrics) -> None:
        rows.append(row)
        drawn.append(drawing.seconds)

    def long_enough() -> bool:
        begun = rows[WARM_UP_UPDATES:]
        return bool(begun) and begun[-1]["wall_time_s"] - begun[0]["wall_time_s"] > config.seconds

    policy = parts.new_policy(config.seed)
    hooks = Hooks(on_metrics=note, should_stop=long_enough)
    PPOTrainer(numbers, policy, NumpyToTorch(env), seed=config.seed, hooks=hooks).train(10**9)
    first, last = WARM_UP_UPDATES, len(rows) - 1
    seconds = rows[last]["wall_time_s"] - rows[first]["wall_time_s"]
    steps = rows[last]["step"] - rows[first]["step"]
    images_s = drawn[last] - drawn[first]

    def total(name: str) -> float:
        return sum(row[name] for row in rows[first + 1 :])

    return {
        "name": "ppo",
        "what": "KnowArm, recurrent PPO",
        "envs": numbers.num_envs,
        "steps_per_s": steps / seconds,
        "share_simulation": (total("environment_s") - images_s) / seconds,
        "share_image": images_s / seconds,
        "share_inference": total("inference_s") / seconds,
        "share_update": total("learn_s") / seconds,
    }


def _a3c(config: BenchConfig, workers: int, envs_per_worker: int) -> dict[str, Any]:
    """Our A3C: the paper's 17 workers of one environment each, or few workers of many."""
    chosen = experiment_config(f"{config.robot}-full-a3c")
    parts = build(chosen)
    numbers = A3CConfig(
        workers=workers,
        envs_per_worker=envs_per_worker,
        # 17 x 1 is the paper's and has its precision.
        matmul_precision="float32" if envs_per_worker == 1 else "auto",
        log_every_steps=50 * envs_per_worker,
    )
    marks: list[tuple[float, float, float]] = []

    def note(row: Metrics) -> None:
        # Counting begins when every worker has done something: starting processes takes seconds.
        if all(row[f"worker_{i}_steps"] for i in range(workers)):
            marks.append((row["step"], row["wall_time_s"], row["staleness_mean"]))

    policy = parts.new_policy(config.seed)
    hooks = Hooks(
        on_metrics=note,
        should_stop=lambda: bool(marks) and marks[-1][1] - marks[0][1] > config.seconds,
    )
    A3CTrainer(numbers, policy, EnvFactory(chosen.env), seed=config.seed, hooks=hooks).train(
        10**9
    )
    steps, seconds = marks[-1][0] - marks[0][0], marks[-1][1] - marks[0][1]
    return {
        "name": "a3c" if envs_per_worker == 1 else "a3c-batched",
        "what": f"KnowArm, A3C, {workers} workers of {envs_per_worker}",
        "envs": workers * envs_per_worker,
        "steps_per_s": steps / seconds,
        "staleness_mean": sum(mark[2] for mark in marks) / len(marks),
    }


def _sb3(config: BenchConfig, *, opengl: bool) -> dict[str, Any]:
    """sb3-contrib's RecurrentPPO, on our vector environment or on single ones with OpenGL."""
    try:
        from knowarm.bench.sb3_baseline import (
            RolloutClock,
            parameter_count,
            recurrent_ppo,
            single_environments,
        )
        from knowarm.learn.sb3_vec_env import SB3VecEnv
    except ImportError as error:
        raise UserError(
            f"The comparison needs a package that is not installed ({error.name}): "
            "pip install 'knowarm[sb3]'."
        ) from error
    chosen = experiment_config(f"{config.robot}-full-ppo")
    parts = build(chosen)
    numbers = _ppo_numbers(config)
    env: VecEnv
    if opengl:
        env_config = replace(chosen.env, renderer="opengl")
        # A quarter of our rollout, since one of ours would take a minute; a step costs the same.
        numbers = replace(numbers, num_envs=config.opengl_envs, rollout_steps=100)
        env = single_environments(env_config, parts.table, config.opengl_envs)
    else:
        vector = ReachVectorEnv(chosen.env, numbers.num_envs, num_threads=config.cores)
        env = SB3VecEnv(VectorKnowledgeObservation(vector, parts.table), seed=config.seed)
    clock = RolloutClock(config.seconds)
    model = recurrent_ppo(parts.new_policy(0), numbers, env, seed=config.seed)
    model.learn(10**9, callback=clock)
    env.close()
    (first_step, first_s), (last_step, last_s) = clock.marks[1], clock.marks[-1]
    return {
        "name": "sb3-opengl" if opengl else "sb3",
        "what": "sb3-contrib, RecurrentPPO, "
        + ("single environments, MuJoCo's OpenGL" if opengl else "KnowArm's vector environment"),
        "envs": numbers.num_envs,
        "steps_per_s": (last_step - first_step) / (last_s - first_s),
        "parameters": parameter_count(model),
        "parameters_ours": sum(p.numel() for p in parts.new_policy(0).parameters()),
    }


def _ppo_numbers(config: BenchConfig) -> PPOConfig:
    return PPOConfig(
        num_envs=128, rollout_steps=25, minibatches=4, epochs=config.epochs, processes=config.cores
    )


class _DrawingClock:
    """Stands before what draws the images and adds up its time."""

    def __init__(self, env: ReachVectorEnv) -> None:
        self.seconds = 0.0
        self._renderer = env.renderer
        env.renderer = self

    def draw(self, *arguments: Any, **options: Any) -> NDArray[np.uint8]:
        """As `Renderer.draw`."""
        begin = time.perf_counter()
        images = self._renderer.draw(*arguments, **options)
        self.seconds += time.perf_counter() - begin
        return images
