"""A number of environments goes in; its speeds, memory and distance to the ceilings come out."""

import gc
from dataclasses import replace

import torch

from knowarm.bench.gpu_config import GpuBenchConfig
from knowarm.bench.gpu_estimate import environment_bytes, training_bytes, training_operations
from knowarm.bench.gpu_rows import Row, count_rays, environment_row, training_row
from knowarm.errors import UserError
from knowarm.experiment.build import Parts, build
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.registry import experiment_config
from knowarm.learn import PPOConfig
from knowarm.world.torch_env import TorchReachVectorEnv

Ceilings = dict[str, float | None]
"""As ``measure_ceilings`` returns them."""


def measure_row(
    config: GpuBenchConfig, num_envs: int, ceilings: Ceilings, device: torch.device
) -> Row:
    """Measure one number of environments.

    Returns:
        ``num_envs``; what ``environment_row`` and ``training_row`` return, the latter's share of
        the environment divided as the former found it; the estimates ``*_bytes_per_step`` and
        ``*_operations_per_step``; the shares of the ceilings that were reached,
        ``*_bandwidth_share`` and ``*_operations_share``; ``torch_peak_bytes`` and
        ``device_used_bytes``, None on the CPU; ``error``, the first sentence of what did not fit,
        else None.
    """
    row: Row = {"num_envs": num_envs, "error": None}
    row |= {"torch_peak_bytes": None, "device_used_bytes": None}
    chosen = experiment_config(f"{config.robot}-full-ppo")
    chosen = replace(chosen, env=replace(chosen.env, image_size=config.image_size))
    if device.type == "cuda":
        torch.cuda.reset_peak_memory_stats(device)
    try:
        _measure(config, chosen, row, ceilings, device)
    except Exception as error:
        if not _does_not_fit(error):
            raise
        row["error"] = first_sentence(str(error))
    gc.collect()  # so that the next row finds the memory free
    if device.type == "cuda":
        torch.cuda.empty_cache()
    return row


def _measure(
    config: GpuBenchConfig,
    chosen: ExperimentConfig,
    row: Row,
    ceilings: Ceilings,
    device: torch.device,
) -> None:
    """Fill a row, as far as it gets."""
    env = TorchReachVectorEnv(chosen.env, row["num_envs"], device=config.device, simulator="warp")
    row |= environment_row(env, config.seconds, config.seed)
    moved, rays = environment_bytes(env.scene, chosen.env), count_rays(env)
    row |= {"env_bytes_per_step": moved, "env_operations_per_step": rays}
    row |= shares_of_ceilings("env", row["env_steps_per_s"], moved, [(rays, "float32")], ceilings)
    if not config.training:
        return
    parts = build(chosen)
    row |= training_row(env, parts, _ppo(config, row["num_envs"]), config.seconds, config.seed)
    for part in ("physics", "images", "rest"):
        share = row["training_share_environment"] * row[f"env_share_{part}"]
        row[f"training_share_{part}"] = share
    row |= _training_estimate(config, chosen, parts, row, ceilings)


def _training_estimate(
    config: GpuBenchConfig,
    chosen: ExperimentConfig,
    parts: Parts,
    row: Row,
    ceilings: Ceilings,
) -> Row:
    policy, precision = parts.new_policy(config.seed), row["precision"]
    item = 2 if precision == "bfloat16" else 4
    moved = row["env_bytes_per_step"] + training_bytes(policy, chosen.env, config.epochs, item)
    products, rays = training_operations(policy, config.epochs), row["env_operations_per_step"]
    operations = [(rays, "float32"), (products, precision)]
    return {
        "training_bytes_per_step": moved,
        "training_operations_per_step": rays + products,
    } | shares_of_ceilings("training", row["training_steps_per_s"], moved, operations, ceilings)


def shares_of_ceilings(
    what: str,
    steps_per_s: float,
    moved: float,
    operations: list[tuple[float, str]],
    ceilings: Ceilings,
) -> Row:
    """How near a speed is to what bandwidth, or rates of operations alone, would allow: 1 is there.

    Args:
        what: prefix of the names.
        steps_per_s: the speed.
        moved: bytes a step.
        operations: operations a step, and the precision at whose rate they are done.
        ceilings: as measured.
    """
    busy = 0.0
    for count, precision in operations:
        rate = ceilings[f"{precision}_operations_per_s"]
        assert rate is not None, precision
        busy += count / rate
    bandwidth = ceilings["copy_bytes_per_s"]
    assert bandwidth is not None
    return {
        f"{what}_bandwidth_share": steps_per_s * moved / bandwidth,
        f"{what}_operations_share": steps_per_s * busy,
    }


def _ppo(config: GpuBenchConfig, num_envs: int) -> PPOConfig:
    """PPO in minibatches of at most ``minibatch_envs`` environments."""
    minibatches = -(-num_envs // config.minibatch_envs)
    while num_envs % minibatches:
        minibatches += 1
    return PPOConfig(
        device="cuda" if config.device != "cpu" else "cpu",
        num_envs=num_envs,
        rollout_steps=config.rollout_steps,
        epochs=config.epochs,
        minibatches=minibatches,
        matmul_precision=config.matmul_precision,
    )


def _does_not_fit(error: Exception) -> bool:
    """Whether an error says that memory is too small: ours, torch's, Warp's or the driver's."""
    text = str(error).lower()
    return isinstance(error, UserError) or "memory" in text or "alloc" in text


def first_sentence(text: str) -> str:
    """Return what a message begins with: up to its first full stop or line end."""
    line = text.strip().splitlines()[0] if text.strip() else "no message"
    end = line.find(". ")
    return line if end < 0 else line[: end + 1]
