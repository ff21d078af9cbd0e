"""One row of the GPU benchmark: speed, memory and shares of the peak rates."""

import gc
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch

from knowarm.bench.clock import (
    PartClock,
    host_seconds_per_call,
    seconds_per_call,
    synchronize,
)
from knowarm.bench.gpu_estimate import (
    environment_bytes,
    ray_operations,
    training_bytes,
    training_operations,
)
from knowarm.bench.learn import Row, train_ppo
from knowarm.errors import UserError
from knowarm.experiment.build import Parts, build
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.registry import DEFAULT_EXPERIMENT, experiment_config
from knowarm.learn import PPOConfig
from knowarm.learn.device import PrecisionChoice
from knowarm.world.tasks.reach import ACTION_LEVELS
from knowarm.world.torch_env import TorchReachVectorEnv

WARM_UP_STEPS = 10
"""Steps that are not measured: kernels are compiled and memory is allocated."""

PART_STEPS = 50
"""Maximum number of steps whose parts are timed."""

RAY_STATES = 32
"""Maximum number of environments whose rays are counted."""

Ceilings = dict[str, float | None]
"""Peak rates of a device, see ``measure_ceilings``."""


@dataclass(frozen=True, kw_only=True)
class GpuBenchConfig:
    """Settings of the GPU benchmark."""

    device: str = "cuda"
    """"cuda", or "cpu" to check that the benchmark runs."""

    experiment: str = DEFAULT_EXPERIMENT
    """Experiment whose robot, agent and task are measured."""

    num_envs: tuple[int, ...] = (256, 1024, 4096, 16384)
    """Numbers of parallel environments, one row each."""

    seconds: float = 5.0
    """Minimum measuring time per value [s]."""

    image_size: int = 64
    """Side length of the images [px]."""

    training: bool = True
    """Also measure training."""

    matmul_precision: PrecisionChoice = "auto"
    """Precision of matrix products in training, as in ``PPOConfig``."""

    rollout_steps: int = 25
    """Steps of each environment between two updates."""

    epochs: int = 2
    """Passes over each rollout."""

    minibatch_envs: int = 256
    """Maximum number of environments per minibatch."""

    copy_bytes: int = 2**30
    """Size of the array whose copying measures the bandwidth [bytes]."""

    matmul_side: int = 8192
    """Side length of the square matrices whose product measures the rate of operations."""

    seed: int = 0
    """Seed of weights, episodes and actions."""

    def __post_init__(self) -> None:
        sizes = "image_size rollout_steps epochs minibatch_envs copy_bytes matmul_side"
        for name in sizes.split():
            if getattr(self, name) < 1:
                raise UserError(f"{name} must be at least 1, got {getattr(self, name)}.")
        if not self.seconds > 0:
            raise UserError(f"seconds must be larger than 0, got {self.seconds}.")
        if not self.num_envs or min(self.num_envs) < 1:
            raise UserError(f"num_envs must be numbers of at least 1, got {self.num_envs}.")

    def ppo(self, num_envs: int) -> PPOConfig:
        """Return PPO's settings with minibatches of at most ``minibatch_envs`` environments."""
        minibatches = -(-num_envs // self.minibatch_envs)
        while num_envs % minibatches:
            minibatches += 1
        return PPOConfig(
            device="cuda" if self.device != "cpu" else "cpu",
            num_envs=num_envs,
            rollout_steps=self.rollout_steps,
            epochs=self.epochs,
            minibatches=minibatches,
            matmul_precision=self.matmul_precision,
        )


def measure_row(
    config: GpuBenchConfig, num_envs: int, ceilings: Ceilings, device: torch.device
) -> Row:
    """Measure one number of environments.

    Returns:
        ``num_envs``; the results of ``environment_row`` and ``training_row``, with the training's
        share of the environment divided as in the former; the estimates ``*_bytes_per_step`` and
        ``*_operations_per_step``; the reached shares of the peak rates, ``*_bandwidth_share`` and
        ``*_operations_share``; ``torch_peak_bytes`` and ``device_used_bytes``, None on the CPU;
        ``error``, the first sentence of the error if memory is too small, else None.
    """
    row: Row = {"num_envs": num_envs, "error": None}
    row |= {"torch_peak_bytes": None, "device_used_bytes": None}
    chosen = experiment_config(config.experiment)
    chosen = replace(chosen, env=replace(chosen.env, image_size=config.image_size))
    if device.type == "cuda":
        torch.cuda.reset_peak_memory_stats(device)
    try:
        _measure(config, chosen, row, ceilings)
    except Exception as error:
        if not _is_out_of_memory(error):
            raise
        row["error"] = first_sentence(str(error))
    gc.collect()  # frees the memory for the next row
    if device.type == "cuda":
        torch.cuda.empty_cache()
    return row


def _measure(
    config: GpuBenchConfig, chosen: ExperimentConfig, row: Row, ceilings: Ceilings
) -> None:
    """Fill a row in place; an error leaves the values measured before it."""
    env = TorchReachVectorEnv(chosen.env, row["num_envs"], device=config.device, simulator="warp")
    row |= environment_row(env, config.seconds, config.seed)
    moved, rays = environment_bytes(env.scene, chosen.env), count_rays(env)
    row |= {"env_bytes_per_step": moved, "env_operations_per_step": rays}
    row |= shares_of_ceilings("env", row["env_steps_per_s"], moved, [(rays, "float32")], ceilings)
    if not config.training:
        return
    parts = build(chosen)
    row |= training_row(config, env, parts)
    for part in ("physics", "images", "rest"):
        share = row["training_share_environment"] * row[f"env_share_{part}"]
        row[f"training_share_{part}"] = share
    policy, precision = parts.new_policy(config.seed), row["precision"]
    item = 2 if precision == "bfloat16" else 4
    moved += training_bytes(policy, chosen.env, config.epochs, item)
    products = training_operations(policy, config.epochs)
    row |= {"training_bytes_per_step": moved, "training_operations_per_step": rays + products}
    operations = [(rays, "float32"), (products, precision)]
    speed = row["training_steps_per_s"]
    row |= shares_of_ceilings("training", speed, moved, operations, ceilings)


def environment_row(env: TorchReachVectorEnv, seconds: float, seed: int) -> Row:
    """Measure environment steps per second with images; random actions are drawn on the device.

    Args:
        env: the environments. Their episodes are not at a defined step afterwards.
        seconds: minimum measuring time [s].
        seed: seed of episodes and actions.

    Returns:
        ``env_steps_per_s``; ``step_ms``, time per step of all environments [ms]; ``host_ms``, time
        that the host needs to issue such a step [ms]; ``env_share_physics``, ``env_share_images``
        and ``env_share_rest`` (episodes, looks, rewards) of ``step_ms``; and the result of
        ``memory_row``.
    """
    generator = torch.Generator(env.device).manual_seed(seed)
    shape = (env.num_envs, env.scene.num_joints)

    def step() -> None:
        env.step(torch.randint(len(ACTION_LEVELS), shape, generator=generator, device=env.device))

    env.reset(seed=seed)
    for _ in range(WARM_UP_STEPS):
        step()
    each = seconds_per_call(step, seconds, env.device)
    steps = max(1, min(PART_STEPS, round(seconds / each)))
    row = {"env_steps_per_s": env.num_envs / each, "step_ms": 1000 * each}
    row["host_ms"] = 1000 * host_seconds_per_call(step, env.device)
    return row | _part_shares(env, step, steps) | memory_row(env.device)


def _part_shares(env: TorchReachVectorEnv, step: Callable[[], None], steps: int) -> Row:
    """Measure the shares of physics, images and the rest over some steps."""
    clock = PartClock(env.device)
    clock.time_methods("physics", env.simulation, "step", "reset")
    clock.time_methods("images", env.renderer, "draw")

    def run() -> None:
        for _ in range(steps):
            step()

    synchronize(env.device)
    try:
        clock.timed("whole", run)()
        seconds = clock.seconds()
    finally:
        clock.restore()
    shares = {part: seconds[part] / seconds["whole"] for part in ("physics", "images")}
    shares["rest"] = 1 - sum(shares.values())
    return {f"env_share_{part}": share for part, share in shares.items()}


def count_rays(env: TorchReachVectorEnv) -> float:
    """Return the ray operations per image, averaged over some environments in their state."""
    count = min(RAY_STATES, env.num_envs)
    position, matrix, rgba = (
        values[:count].cpu().numpy()
        for values in (
            env.simulation.geom_position,
            env.simulation.geom_matrix,
            env.task.shown.rgba,
        )
    )
    return ray_operations(env.scene, env.config, position, matrix, rgba)


def training_row(config: GpuBenchConfig, env: TorchReachVectorEnv, parts: Parts) -> Row:
    """Measure steps per second of training: physics, images, network and update.

    Returns:
        ``training_steps_per_s``; ``training_share_environment``, ``training_share_inference`` and
        ``training_share_update`` of the time; ``precision`` of the matrix products; and the
        result of ``memory_row``.
    """
    ppo = config.ppo(env.num_envs)
    row = train_ppo(ppo, parts, env, seconds=config.seconds, seed=config.seed)
    names = ("steps_per_s", "share_environment", "share_inference", "share_update")
    measured = {f"training_{name}": row[name] for name in names}
    return measured | {"precision": row["precision"]} | memory_row(env.device)


def memory_row(device: torch.device) -> Row:
    """Return the memory in use on a device.

    Returns:
        ``torch_peak_bytes``, peak size of torch's tensors; ``device_used_bytes``, memory now
        allocated by all libraries (Warp, Numba, torch's cache). None on the CPU.
    """
    if device.type != "cuda":
        return {"torch_peak_bytes": None, "device_used_bytes": None}
    free, total = torch.cuda.mem_get_info(device)
    return {
        "torch_peak_bytes": torch.cuda.max_memory_allocated(device),
        "device_used_bytes": total - free,
    }


def shares_of_ceilings(
    what: str,
    steps_per_s: float,
    moved: float,
    operations: list[tuple[float, str]],
    ceilings: Ceilings,
) -> dict[str, float]:
    """Return the reached shares of the bandwidth and of the rates of operations; 1 is the peak.

    Args:
        what: prefix of the names in the result.
        steps_per_s: measured speed.
        moved: bytes per step.
        operations: (count, precision) pairs, operations per step in each precision.
        ceilings: measured peak rates.
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


def _is_out_of_memory(error: Exception) -> bool:
    """Tell whether an error reports too little memory: ours, torch's, Warp's or the driver's."""
    text = str(error).lower()
    return isinstance(error, UserError) or "memory" in text or "alloc" in text


def first_sentence(text: str) -> str:
    """Return a message up to its first full stop or line end."""
    line = text.strip().splitlines()[0] if text.strip() else "no message"
    end = line.find(". ")
    return line if end < 0 else line[: end + 1]
