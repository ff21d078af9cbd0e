"""First contact with a GPU: compilers, one step of everything, and where its time goes.

    python -m benchmarks.gpu_smoke [--device cuda]

Reports the time until each part worked for the first time. Rollout and gradient then run with an
error at every synchronization with the GPU, and under torch's profiler.
"""

import argparse
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import torch
from torch.profiler import ProfilerActivity, profile

from knowarm.experiment.build import build
from knowarm.experiment.registry import DEFAULT_EXPERIMENT, experiment_config
from knowarm.learn import PPOConfig
from knowarm.learn.collector import Collector
from knowarm.learn.device import resolve_precision
from knowarm.learn.learner import Learner
from knowarm.learn.minibatch import TrainingNetwork
from knowarm.world.torch_env import TorchReachVectorEnv

ROLLOUT_STEPS = 8
"""Steps of a rollout: more than are executed before a step is recorded."""

ROWS = 25
"""Operations in the table of the profile."""


@contextmanager
def timed(what: str, device: torch.device) -> Iterator[None]:
    """Print how long something takes, the work of the device included."""
    start = time.perf_counter()
    yield
    if device.type == "cuda":
        torch.cuda.synchronize(device)
    print(f"{time.perf_counter() - start:7.2f} s  {what}", flush=True)


@contextmanager
def without_synchronization(device: torch.device) -> Iterator[None]:
    """Raise an error where torch synchronizes with the GPU."""
    if device.type != "cuda":
        yield
        return
    torch.cuda.set_sync_debug_mode("error")
    try:
        yield
    finally:
        torch.cuda.set_sync_debug_mode("default")


def first_kernel(device: torch.device) -> None:
    """Compile and launch one small kernel of the ray caster, with the NVVM that Numba found."""
    if device.type != "cuda":
        return
    from knowarm.world.render.cuda_kernels import cuda, fill_kernel

    numbers = cuda.device_array(64, dtype="int32")
    fill_kernel[1, 64](numbers, 7)
    assert (numbers.copy_to_host() == 7).all()


def profiled(what: str, run: Callable[[], Any], device: torch.device) -> None:
    """Print the operations on which ``run`` spends most time, on the device if it is a GPU."""
    kinds, order = [ProfilerActivity.CPU], "self_cpu_time_total"
    if device.type == "cuda":
        kinds, order = [*kinds, ProfilerActivity.CUDA], "self_cuda_time_total"
    with profile(activities=kinds) as found:
        run()
        if device.type == "cuda":
            torch.cuda.synchronize(device)
    print(f"\n== {what}")
    table = found.key_averages().table(sort_by=order, row_limit=ROWS, max_name_column_width=60)
    print("\n".join(line.rstrip() for line in table.splitlines()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cuda")
    parser.add_argument("--num-envs", type=int, default=1024)
    parser.add_argument("--image-size", type=int, default=64)
    options = parser.parse_args()
    device = torch.device(options.device)
    chosen = experiment_config(DEFAULT_EXPERIMENT)
    chosen = replace(chosen, env=replace(chosen.env, image_size=options.image_size))
    with timed("one kernel of Numba", device):
        first_kernel(device)
    with timed("environment made", device):
        env = TorchReachVectorEnv(
            chosen.env, options.num_envs, device=options.device, simulator="warp"
        )
    config = PPOConfig(
        device=options.device,
        num_envs=options.num_envs,
        rollout_steps=ROLLOUT_STEPS,
        minibatches=max(1, options.num_envs // 256),
    )
    precision = resolve_precision(config.matmul_precision, env.device)
    policy = build(chosen).new_policy(0).to(env.device)
    policy.matmul_precision = precision
    learner = Learner(TrainingNetwork(policy, 0), config, precision, env.device)
    env_ids = torch.arange(options.num_envs // config.minibatches, device=env.device)
    collector = Collector(env, policy, seed=0)

    def rollout() -> None:
        collector.collect(learner.rollout, learner.infer)

    def gradient() -> None:
        learner.compute_gradient(env_ids)

    with learner.running():
        for what, run in (("rollout", rollout), ("gradient", gradient)):
            with timed(f"first {what}", env.device):
                run()
            with timed(f"{what} again", env.device), without_synchronization(env.device):
                run()
        assert float(learner.rollout.patches.float().std()) > 0, "the images are empty"
        assert bool(torch.isfinite(learner.gradient).all()), "the gradient is not finite"
        profiled(f"rollout of {ROLLOUT_STEPS} steps, {options.num_envs} envs", rollout, env.device)
        profiled(f"gradient over {len(env_ids)} environments", gradient, env.device)
    env.close()


if __name__ == "__main__":
    main()
