"""A number of environments goes in; how fast they step and train on a device comes out."""

from typing import Any

import torch

from knowarm.bench.gpu_clock import PartClock, seconds_per_call, synchronize
from knowarm.bench.gpu_rays import ray_operations
from knowarm.experiment.build import Parts
from knowarm.learn import Hooks, Metrics, PPOConfig, PPOTrainer
<<<<<<< HEAD
from knowarm.policy import Policy
from knowarm.world.tasks.reach import ACTION_LEVELS
from knowarm.world.torch_env import TorchReachVectorEnv
=======
from knowarm.world.env import ACTION_LEVELS
from knowarm.world.gpu.env import DeviceReachVectorEnv
>>>>>>> learn

WARM_UP_STEPS = 10
"""Steps before anything is timed: kernels compile and memory is set aside."""

WARM_UP_UPDATES = 2
"""Updates that are not counted: the first ones compile and fill caches."""

PART_STEPS = 50
"""Most steps whose parts are timed."""

RAY_STATES = 32
"""Most environments whose rays are counted."""

Row = dict[str, Any]


def environment_row(env: TorchReachVectorEnv, seconds: float, seed: int) -> Row:
    """Measure environment steps a second with images, actions drawn at random on the device.

    Args:
        env: the environments; left somewhere in their episodes.
        seconds: time that is measured, at least [s].
        seed: of episodes and actions.

    Returns:
        ``env_steps_per_s``; ``step_ms``, the time of one step of all environments [ms];
        ``env_share_physics``, ``_images`` and ``_rest`` (episodes, looks, rewards) of it; and
        what ``memory_row`` returns.
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
    row |= {f"env_{name}": share for name, share in _part_shares(env, step, steps).items()}
    return row | memory_row(env.device)


def _part_shares(env: TorchReachVectorEnv, step: Any, steps: int) -> dict[str, float]:
    """Share of physics, images and the rest in the time of some steps."""
    clock = PartClock(env.device)
    simulation, images = env.simulation, env.renderer
    own: Any = simulation
    own.step, own.reset = (
        clock.timed("physics", simulation.step),
        clock.timed("physics", simulation.reset),
    )
    drawing: Any = images
    drawing.draw = clock.timed("images", images.draw)
    synchronize(env.device)
    whole = clock.timed("whole", lambda: [step() for _ in range(steps)])
    try:
        whole()
        seconds = clock.seconds()
    finally:
        del own.step, own.reset, drawing.draw  # the classes' own methods again
    shares = {f"share_{name}": seconds[name] / seconds["whole"] for name in ("physics", "images")}
    return shares | {"share_rest": 1 - sum(shares.values())}


def count_rays(env: TorchReachVectorEnv) -> float:
    """Operations of the rays of one image, mean over some environments as they are now."""
    count = min(RAY_STATES, env.num_envs)
    simulation = env.simulation
    position, matrix, rgba = (
        values[:count].cpu().numpy()
        for values in (simulation.geom_position, simulation.geom_matrix, env.task.shown.rgba)
    )
    return ray_operations(env.scene, env.config, position, matrix, rgba)


def training_row(
    env: TorchReachVectorEnv, parts: Parts, numbers: PPOConfig, seconds: float, seed: int
) -> Row:
    """Measure steps a second of training end to end: physics, images, network and update.

    Args:
        env: the environments.
        parts: the experiment's network and knowledge.
        numbers: how is trained.
        seconds: time that is measured after the first updates, at least [s].
        seed: of everything.

    Returns:
        ``training_steps_per_s``; ``training_share_environment``, ``_inference`` and ``_update`` of
        the time; ``precision`` that was trained in; and what ``memory_row`` returns.
    """
    rows: list[Metrics] = []

    def long_enough() -> bool:
        begun = rows[WARM_UP_UPDATES - 1 :]
        return len(begun) > 1 and begun[-1]["wall_time_s"] - begun[0]["wall_time_s"] > seconds

    hooks = Hooks(on_metrics=rows.append, should_stop=long_enough)
    policy = parts.new_policy(seed)
    trainer = PPOTrainer(numbers, policy, env, seed=seed, hooks=hooks)
    trainer.train(10**12)
    first, last = rows[WARM_UP_UPDATES - 1], rows[-1]
    elapsed = last["wall_time_s"] - first["wall_time_s"]

    def share(name: str) -> float:
        return sum(row[name] for row in rows[WARM_UP_UPDATES:]) / elapsed

    return {
        "training_steps_per_s": (last["step"] - first["step"]) / elapsed,
        "training_share_environment": share("environment_s"),
        "training_share_inference": share("inference_s"),
        "training_share_update": share("learn_s"),
        "precision": trainer.matmul_precision,
    } | memory_row(env.device)


def memory_row(device: torch.device) -> Row:
    """Tell how full a device is, as long as what fills it is there.

    Returns:
        ``torch_peak_bytes``, what torch's tensors took at most; ``device_used_bytes``, what is
        taken now by everybody, Warp, Numba and what torch keeps for later included. None on the
        CPU.
    """
    if device.type != "cuda":
        return {"torch_peak_bytes": None, "device_used_bytes": None}
    free, total = torch.cuda.mem_get_info(device)
    return {
        "torch_peak_bytes": torch.cuda.max_memory_allocated(device),
        "device_used_bytes": total - free,
    }
