"""Speed of this machine: simulation, images and training, and how much of its peak training uses.

python -m benchmarks.speed --json runs/bench/speed.json
"""

import os
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import psutil
import torch
import tyro
from torch.utils.flop_counter import FlopCounterMode

from knowarm.cli.tables import check_output, print_table, write_json_table
from knowarm.cores import available_cores, processor, torch_threads
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.knows import NoKnowledge
from knowarm.experiment.names import DEFAULT_EXPERIMENT, experiment_config
from knowarm.experiment.run import build, make_trainer
from knowarm.learn import A3CConfig, DistilConfig, Hooks, Metrics
from knowarm.learn.algorithms import MinibatchConfig
from knowarm.learn.optimizer import PolicyOptimizer
from knowarm.ranges import LEAST, MOST_INT, within
from knowarm.world.config import EnvConfig
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.tasks.state import ACTION_LEVELS

WARM_UP_ROWS = 2
"""Rows of the training metrics that are not measured: the first updates compile."""
NEVER = 10**12
PRODUCT = 1536
"""Rows and columns of the matrices whose product measures the processor's peak."""


@dataclass(frozen=True, kw_only=True)
class SpeedConfig:
    """Settings of the measurement."""

    experiment: str = DEFAULT_EXPERIMENT
    """Experiment whose robot, task and algorithm are measured."""

    num_envs: int = 256
    """Number of environments that are simulated in parallel."""

    seconds: float = 5.0
    """Least measuring time of each row [s]."""

    json: Path | None = None
    """Also write the results to this file."""


class Speed(NamedTuple):
    """Steps of a vector environment per second, by the clock and of CPU time of all processes."""

    steps_per_s: float
    steps_per_cpu_s: float


def cpu_seconds() -> float:
    """Return the CPU time used so far by this process and all of its child processes [s]."""
    # The system counts other processes' time in ticks of 10 ms: a short measurement may see none.
    running = psutil.Process().children(recursive=True)
    ended = sum(os.times()[2:4])
    return (
        time.process_time()
        + ended
        + sum(sum(child.cpu_times()[:4]) for child in running)
    )


def measure_steps(env: gymnasium.vector.VectorEnv, seconds: float) -> Speed:
    """Measure a vector environment for some seconds, after three warm-up steps.

    The actions are random, ``MultiDiscrete([levels] * joints)``.
    """
    env.reset(seed=0)
    shape = (64, env.num_envs, *(env.single_action_space.shape or ()))
    actions = np.random.default_rng(0).integers(len(ACTION_LEVELS), size=shape)
    for i in range(3):
        env.step(actions[i])
    count, start, cpu = 0, time.perf_counter(), cpu_seconds()
    while (elapsed := time.perf_counter() - start) < seconds or count == 0:
        env.step(actions[count % 64])
        count += 1
    steps = count * env.num_envs
    return Speed(steps / elapsed, steps / (cpu_seconds() - cpu))


def measure_images(config: EnvConfig, *, num_envs: int, seconds: float) -> float:
    """Return images per second of CPU time of the ray caster, ``num_envs`` per call."""
    env = ArmVectorEnv(config, num_envs, num_threads=1)
    env.reset(seed=0)
    poses = (
        env.simulation.geom_position,
        env.simulation.geom_matrix,
        env.running.shown.rgba,
    )
    env.renderer.draw(*poses)
    count, start, cpu = 0, time.perf_counter(), cpu_seconds()
    while time.perf_counter() - start < seconds or count == 0:
        env.renderer.draw(*poses)
        count += 1
    return count * num_envs / (cpu_seconds() - cpu)


def _measurable(config: ExperimentConfig) -> ExperimentConfig:
    """Replace an agent with a grounding network by the baseline agent of the same task."""
    if config.knows.grounding is None:
        return config
    return replace(config, knows=NoKnowledge())


def measure_training(config: ExperimentConfig, seconds: float) -> float:
    """Return the steps per second by the clock of a training without evaluations, after warm-up.

    Instead of an agent with a grounding network, which would have to be trained first, the baseline
    agent is measured on the same task.
    """
    config = _measurable(config)
    if isinstance(
        config.algorithm, A3CConfig
    ):  # by default minutes pass between two rows
        config = replace(
            config, algorithm=replace(config.algorithm, log_every_steps=1000)
        )
    elif isinstance(config.algorithm, DistilConfig):  # glimpses would never end
        config = replace(config, algorithm=replace(config.algorithm, glimpse_until=0.0))
    rows: list[Metrics] = []

    def is_enough() -> bool:
        begin = rows[WARM_UP_ROWS - 1 :]
        return (
            len(begin) > 1
            and begin[-1]["wall_time_s"] - begin[0]["wall_time_s"] >= seconds
        )

    config = replace(config, interim=replace(config.interim, episodes=1))
    hooks = Hooks(on_metrics=rows.append, should_stop=is_enough)
    parts = build(config)
    policy = parts.new_policy(config.seed)
    make_trainer(
        config, policy, parts.knowledge, evaluate_every=NEVER, hooks=hooks
    ).train(NEVER)
    first, last = rows[WARM_UP_ROWS - 1], rows[-1]
    return (last["step"] - first["step"]) / (last["wall_time_s"] - first["wall_time_s"])


def training_flops(config: ExperimentConfig) -> float:
    """Count the operations of the network per environment step: one inference and all passes.

    Matrix products and convolutions of inference, forward and backward passes and Muon are counted
    by running them on one image; a multiplication and an addition are two operations. Simulation,
    images and element-wise work are not included.
    """
    algorithm = config.algorithm
    policy = build(_measurable(config)).new_policy(0)
    image = torch.zeros((1, 1, *policy.encoder.patch_shape), dtype=torch.uint8)
    knowledge = torch.zeros((1, 1, policy.knowledge_width))
    start = torch.zeros((1, 1), dtype=torch.bool)
    with FlopCounterMode(display=False) as forward:
        logits, values, _ = policy.unroll(
            image, knowledge, policy.initial_state(1), start
        )
    with FlopCounterMode(display=False) as backward:
        (logits.sum() + values.sum()).backward()
    passes, muon = 1, 0.0
    if isinstance(algorithm, MinibatchConfig):
        optimizer = PolicyOptimizer(dict(policy.named_parameters()), algorithm)
        with FlopCounterMode(display=False) as update:
            optimizer.step()
        minibatch = algorithm.num_envs * algorithm.rollout_steps / algorithm.minibatches
        passes, muon = algorithm.epochs, update.get_total_flops() / minibatch
    once = forward.get_total_flops()
    return once + passes * (once + backward.get_total_flops() + muon)


def measure_peak(cores: int, seconds: float) -> float:
    """Return the operations per second of a product of two float32 matrices on some cores."""
    one = torch.ones(PRODUCT, PRODUCT)
    out, best, start = torch.empty_like(one), float("inf"), time.perf_counter()
    with torch_threads(cores):
        while best == float("inf") or time.perf_counter() - start < seconds:
            begin = time.perf_counter()
            torch.mm(one, one, out=out)
            best = min(best, time.perf_counter() - begin)
    return 2 * PRODUCT**3 / best


def measure_all(settings: SpeedConfig) -> dict[str, Any]:
    """Measure simulation, images, training and the processor's peak, and print a table."""
    within(settings, 1, MOST_INT, "num_envs")
    within(settings, LEAST, MOST_INT, "seconds")
    config = experiment_config(settings.experiment)
    cores = available_cores()
    steps = config.total_steps
    _announce("simulation with images")
    simulation = measure_steps(
        ArmVectorEnv(config.env, settings.num_envs), settings.seconds
    )
    _announce("images alone")
    images = measure_images(
        config.env, num_envs=settings.num_envs, seconds=settings.seconds
    )
    _announce("training, whose first update compiles code")
    training = measure_training(config, settings.seconds)
    _announce("the processor's peak")
    peak = measure_peak(cores, min(settings.seconds, 1.0))
    flops = training_flops(config)
    share = training * flops / peak
    rows = [
        ("Simulation with images", round(simulation.steps_per_s), "steps/s"),
        ("Images alone, one core", round(images), "images/s"),
        ("Training: simulation, policy and learning", round(training), "steps/s"),
        ("Network: operations per training step", round(flops / 1e6, 1), "MFLOP"),
        ("Peak: one product of float32 matrices", round(peak / 1e9, 1), "GFLOP/s"),
        ("Share of the peak that the network uses", round(100 * share, 1), "%"),
        (f"Time to train all {steps:,} steps", steps / training / 3600, "hours"),
    ]
    title = f"{settings.experiment} on {cores} cores, {settings.num_envs} robots simulated at once"
    print_table(title, ["what", "value", "unit"], rows)
    return {
        "experiment": settings.experiment,
        "num_envs": settings.num_envs,
        "simulation_steps_per_s": simulation.steps_per_s,
        "simulation_steps_per_cpu_s": simulation.steps_per_cpu_s,
        "images_per_s_core": images,
        "training_steps_per_s": training,
        "training_flops": flops,
        "peak_flops_per_s": peak,
        "share_of_peak": share,
        "total_steps": steps,
        "machine": {"processor": processor(), "cores": cores, "cpus": os.cpu_count()},
    }


def _announce(what: str) -> None:
    print(f"Measuring {what} ...", file=sys.stderr, flush=True)


def main() -> None:
    settings = tyro.cli(SpeedConfig, description=__doc__)
    check_output(settings.json)
    write_json_table(settings.json, measure_all(settings))


if __name__ == "__main__":
    main()
