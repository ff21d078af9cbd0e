"""A scene and a number of environments go in; the bytes that they take on the device come out."""

import dataclasses
from typing import Any

import torch

from knowarm.errors import UserError
from knowarm.world.config import EnvConfig
from knowarm.world.gpu.device import import_warp
from knowarm.world.gpu.simulation import make_data
from knowarm.world.render.tiles import EXTENT, RECORD
from knowarm.world.scene import Scene

IMAGES = 3
"""Images an environment keeps: the one given out last, the next, and the last of its episode."""

TENSOR_BYTES = 16 * 1024
"""Draws, looks and metrics of an environment, and what computing them takes for a while: at most
140 draws of 8 bytes, a dozen times."""

SHARE = 0.9
"""Part of the free memory that may be filled; the rest is left for fragments and kernels."""


def memory_needed(scene: Scene, config: EnvConfig, num_envs: int) -> int:
    """Compute the bytes that n environments take on the device, without the policy's.

    Warp's arrays are counted by making them on the CPU for one and for two environments. What a
    step allocates for a while was measured as a fifth of them without and nine tenths with
    iterative collisions (IRB120, TIAGo), and counts as much as they do.

    Args:
        scene: what is simulated and drawn.
        config: side of the images.
        num_envs: n.
    """
    one, two = (_data_bytes(scene, count) for count in (1, 2))
    image = 3 * config.image_size**2
    prepared = 4 * (RECORD + EXTENT) * scene.model.ngeom
    each = 2 * (two - one) + IMAGES * image + prepared + TENSOR_BYTES
    return num_envs * each + 2 * (2 * one - two)


def check_memory(scene: Scene, config: EnvConfig, num_envs: int, free: int) -> None:
    """Refuse more environments than the free memory holds.

    Args:
        scene: what is simulated and drawn.
        config: side of the images.
        num_envs: n.
        free: free bytes of the device.

    Raises:
        UserError: they do not fit; the message says how many do.
    """
    needed = memory_needed(scene, config, num_envs)
    if needed <= SHARE * free:
        return
    fixed = memory_needed(scene, config, 0)
    each = (needed - fixed) / num_envs
    fit = max(0, int((SHARE * free - fixed) / each))
    raise UserError(
        f"{num_envs} environments of {config.image_size} x {config.image_size} pixels need about "
        f"{_gigabytes(needed)} of the GPU's memory, and {_gigabytes(free)} are free: up to {fit} "
        "fit, before the policy and its rollouts take theirs. Use fewer environments or smaller "
        "images, or stop what else runs on the GPU."
    )


def free_memory(device: torch.device) -> int:
    """Free bytes of a GPU, with those that torch keeps for itself but does not use."""
    free, _ = torch.cuda.mem_get_info(device)
    kept = torch.cuda.memory_reserved(device) - torch.cuda.memory_allocated(device)
    return free + kept


def _data_bytes(scene: Scene, num_envs: int) -> int:
    warp, _ = import_warp()
    with warp.ScopedDevice("cpu"):
        return _array_bytes(make_data(scene.model, num_envs))


def _array_bytes(value: Any) -> int:
    """Bytes of all Warp arrays in a dataclass."""
    if dataclasses.is_dataclass(value):
        return sum(_array_bytes(getattr(value, f.name)) for f in dataclasses.fields(value))
    return int(getattr(value, "capacity", 0) or 0)


def _gigabytes(count: float) -> str:
    return f"{count / 2**30:.1f} GiB"
