"""Speed of training on the CPU with every configuration of PPO, and with A3C.

python -m benchmarks.learn --json runs/bench/learn.json
"""

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

import torch
import tyro

from benchmarks.speed import measure_images
from benchmarks.time_to_success import refuse_module, time_to_success, trainer_of
from knowarm.cli.tables import check_output, print_table, write_json_table
from knowarm.cores import processor
from knowarm.errors import UserError
from knowarm.experiment.algorithms import ALGORITHMS
from knowarm.experiment.names import DEFAULT_EXPERIMENT, experiment_config
from knowarm.experiment.run import Parts, build
from knowarm.learn import A3CConfig, Hooks, Metrics, PPOConfig, TorchVectorEnv
from knowarm.learn.a3c import A3CTrainer
from knowarm.learn.algorithms import MinibatchConfig

WARM_UP_UPDATES = 3
"""Updates that are not measured: the first ones compile and fill caches."""

PPOS = [
    name
    for name, entry in ALGORITHMS.items()
    if isinstance(entry.config, MinibatchConfig)
]
"""Algorithms that learn from minibatches: configurations of PPO, and imitation."""

PPO, A3C = PPOConfig().name, A3CConfig().name
"""Names of the rows; the paper's A3C has many workers with one environment each."""

A3C_WORKERS = A3CConfig().workers
"""Workers of the paper's A3C."""

A3C_BATCHED = f"{A3C}-batched"
"""Name of the row of A3C with many environments per worker."""

UNLIMITED = 10**9
"""Environment steps to train for; the measuring time ends the training earlier."""

Row = dict[str, Any]
"""Results of one measurement, by name."""


@dataclass(frozen=True, kw_only=True)
class LearnBenchConfig:
    """Settings of the training benchmark."""

    experiment: str = DEFAULT_EXPERIMENT
    """Experiment whose robot, agent and task are trained."""

    cores: int = 2
    """Processes and threads of each learner."""

    seconds: float = 15.0
    """Minimum measuring time per row and turn [s]."""

    turns: int = 3
    """How often the configurations of PPO are measured in turn; the median counts."""

    success_steps: int = 0
    """Also train until 80 % success, for at most so many environment steps; 0: do not."""

    seed: int = 0
    """Seed of weights, episodes and actions."""

    json: Path | None = None
    """Also write the table to this JSON file."""

    def __post_init__(self) -> None:
        if self.cores < 1:
            raise UserError(f"cores must be at least 1, got {self.cores}.")
        if self.turns < 1:
            raise UserError(f"turns must be at least 1, got {self.turns}.")
        if self.success_steps < 0:
            raise UserError(
                f"success_steps must be 0 or more, got {self.success_steps}."
            )

    def ppo(self, name: str = PPO) -> MinibatchConfig:
        """Return the settings of a registered algorithm."""
        return replace(
            cast(MinibatchConfig, ALGORITHMS[name].config), processes=self.cores
        )


def bench_learn(config: LearnBenchConfig | None = None) -> dict[str, Any]:
    """Measure environment steps per second of training: physics, image, policy and update.

    Returns:
        ``rows`` with name, envs, steps_per_s and shares of the time (the row of the ray caster
        counts frames of one core), ``steps_per_s`` of PPO, ``ratio_<name>`` of each other
        configuration of PPO over PPO, ``ratio_a3c_batched`` (A3C with many environments per worker
        over the paper's workers of one), the machine, and ``success`` with the rows of
        `time_to_success`.

    Raises:
        UserError: the agent has a perception module or a grounding network.
    """
    config = config or LearnBenchConfig()
    refuse_module(experiment_config(config.experiment))
    torch.set_num_threads(config.cores)
    rows = [
        raycaster_row(config),
        *in_turns([partial(ppo_row, config, name) for name in PPOS], config.turns),
        *a3c_rows(config),
    ]
    return summarize_rows(config, rows) | {"success": success_rows(config)}


def in_turns(measures: Sequence[Callable[[], Row]], turns: int) -> list[Row]:
    """Measure in turn, since the speed of a machine varies, and return each row of median speed."""
    taken = [[measure() for measure in measures] for _ in range(turns)]
    return [
        sorted(rows, key=lambda row: row["steps_per_s"])[len(rows) // 2]
        for rows in zip(*taken, strict=True)
    ]


def success_rows(config: LearnBenchConfig) -> list[Row]:
    """Train with every configuration of PPO until 80 % success; nothing without a budget."""
    return [
        time_to_success(
            experiment_config(config.experiment),
            name,
            most_steps=config.success_steps,
            processes=config.cores,
            seed=config.seed,
        )
        for name in PPOS
        if config.success_steps
    ]


def summarize_rows(config: LearnBenchConfig, rows: list[Row]) -> dict[str, Any]:
    """Return the rows with the machine, PPO's speed and the speed-up of batched A3C."""
    speed = {row["name"]: row["steps_per_s"] for row in rows}
    return {
        "experiment": config.experiment,
        "cores": config.cores,
        "machine": f"{processor()}, {os.cpu_count()} cores",
        "torch": torch.__version__,
        "rows": rows,
        "steps_per_s": speed[PPO],
        **{f"ratio_{name}": speed[name] / speed[PPO] for name in PPOS if name in speed},
        "ratio_a3c_batched": speed[A3C_BATCHED] / speed[A3C],
    }


def raycaster_row(config: LearnBenchConfig) -> Row:
    """Measure the ray caster alone on one core: a reference for the speed of the machine."""
    env = experiment_config(config.experiment).env
    return {
        "name": "raycaster",
        "what": "KnowArm's ray caster alone, frames of one core",
        "envs": 128,
        "steps_per_s": measure_images(env, num_envs=128, seconds=config.seconds / 2),
    }


def ppo_row(config: LearnBenchConfig, name: str = PPO) -> Row:
    """Measure a registered algorithm that learns from minibatches."""
    chosen, ppo = experiment_config(config.experiment), config.ppo(name)
    parts = build(chosen)
    env = parts.knowledge.make_env(chosen.env, ppo.num_envs, num_threads=config.cores)
    image_seconds = timed(env.renderer, "draw")
    row = train_ppo(
        ppo,
        parts,
        env,
        seconds=config.seconds,
        seed=config.seed,
        image_seconds=image_seconds,
    )
    return {
        "name": name,
        "what": f"KnowArm, {ALGORITHMS[name].about}",
        "envs": ppo.num_envs,
        "steps_per_s": row["steps_per_s"],
        "share_simulation": row["share_environment"] - row["share_images"],
        "share_images": row["share_images"],
        "share_inference": row["share_inference"],
        "share_update": row["share_update"],
    }


def timed(owner: Any, method: str) -> Callable[[], float]:
    """Return a function that gives the time spent in an object's method from now on [s]."""
    call, seconds = getattr(owner, method), [0.0]

    def measured(*arguments: Any, **options: Any) -> Any:
        begin = time.perf_counter()
        result = call(*arguments, **options)
        seconds[0] += time.perf_counter() - begin
        return result

    setattr(owner, method, measured)
    return lambda: seconds[0]


def train_ppo(
    config: MinibatchConfig,
    parts: Parts,
    env: TorchVectorEnv,
    *,
    seconds: float,
    seed: int,
    image_seconds: Callable[[], float] = lambda: 0.0,
) -> Row:
    """Train for a while and measure everything after the first updates.

    Args:
        config: settings of the algorithm.
        parts: policy and knowledge of the experiment.
        env: vector environment with ``config.num_envs`` environments.
        seconds: minimum measuring time [s].
        seed: seed of weights, episodes and actions.
        image_seconds: returns the total time spent rendering so far [s].

    Returns:
        ``steps_per_s``; ``share_environment`` (images included), ``share_images``,
        ``share_inference`` and ``share_update`` of the time.
    """
    rows: list[Metrics] = []
    images: list[float] = []
    first = WARM_UP_UPDATES - 1

    def record(row: Metrics) -> None:
        rows.append(row)
        images.append(image_seconds())

    def elapsed() -> float:
        return rows[-1]["wall_time_s"] - rows[first]["wall_time_s"]

    hooks = Hooks(
        on_metrics=record,
        should_stop=lambda: len(rows) > WARM_UP_UPDATES and elapsed() > seconds,
    )
    policy = parts.new_policy(seed)
    trainer_of(config, policy, env, seed=seed, hooks=hooks).train(UNLIMITED)

    def share(name: str) -> float:
        return sum(row[name] for row in rows[first + 1 :]) / elapsed()

    return {
        "steps_per_s": (rows[-1]["step"] - rows[first]["step"]) / elapsed(),
        "share_environment": share("environment_s"),
        "share_images": (images[-1] - images[first]) / elapsed(),
        "share_inference": share("inference_s"),
        "share_update": share("learn_s"),
    }


def a3c_rows(config: LearnBenchConfig) -> list[Row]:
    """Measure A3C as in the paper, and with many environments per worker."""
    return [
        a3c_row(config, A3C, workers=A3C_WORKERS, envs_per_worker=1),
        a3c_row(config, A3C_BATCHED, workers=config.cores, envs_per_worker=128),
    ]


def a3c_row(
    config: LearnBenchConfig, name: str, *, workers: int, envs_per_worker: int
) -> Row:
    """Measure A3C with a number of worker processes and environments per worker."""
    chosen = experiment_config(config.experiment)
    parts = build(chosen)
    a3c = A3CConfig(
        workers=workers,
        envs_per_worker=envs_per_worker,
        rollout_ends_with_episode=envs_per_worker == 1,
        # One environment per worker is the paper's setting, trained in the paper's precision.
        matmul_precision="float32" if envs_per_worker == 1 else "auto",
        log_every_steps=50 * envs_per_worker,
    )
    marks: list[tuple[float, float]] = []

    def record(row: Metrics) -> None:
        # Measuring starts when every worker has made a step: starting processes takes seconds.
        if all(row[f"worker_{i}_steps"] for i in range(workers)):
            marks.append((row["step"], row["wall_time_s"]))

    hooks = Hooks(
        on_metrics=record,
        should_stop=lambda: bool(marks) and marks[-1][1] - marks[0][1] > config.seconds,
    )
    make_env = partial(parts.knowledge.make_env, chosen.env)
    policy = parts.new_policy(config.seed)
    trainer = A3CTrainer(a3c, policy, make_env, seed=config.seed, hooks=hooks)
    trainer.train(UNLIMITED)
    steps, seconds = marks[-1][0] - marks[0][0], marks[-1][1] - marks[0][1]
    return {
        "name": name,
        "what": f"KnowArm, A3C, {workers} workers of {envs_per_worker}",
        "envs": workers * envs_per_worker,
        "steps_per_s": steps / seconds,
    }


COLUMNS = {
    "name": "learner",
    "envs": "envs",
    "steps_per_s": "steps/s",
    "share_simulation": "physics",
    "share_images": "images",
    "share_inference": "inference",
    "share_update": "update",
}
"""Column titles of the table, by field of a row; the JSON has more fields."""


def print_learn(result: dict[str, Any]) -> None:
    """Print a result of ``bench_learn``: the table and the ratios."""
    print_table(
        f"Training {result['experiment']}, {result['cores']} threads or processes each",
        list(COLUMNS.values()),
        [[row.get(name) for name in COLUMNS] for row in result["rows"]],
    )
    if result["success"]:
        print_table(
            "Until 80 % of 100 interim episodes succeed",
            ["name", "what", "steps", "seconds", "best success", "at most"],
            [list(row.values()) for row in result["success"]],
        )
    print("physics, images, inference, update: shares of the time.")
    print("raycaster: frames/s of one core, without training.")
    for name, value in result.items():
        if name.startswith("ratio_") and value is not None:
            print(f"{name}: {value:.2f}")


def main() -> None:
    config = tyro.cli(LearnBenchConfig, description=__doc__)
    check_output(config.json)
    result = bench_learn(config)
    print_learn(result)
    write_json_table(config.json, result)


if __name__ == "__main__":
    main()
