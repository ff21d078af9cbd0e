"""Devices of the torch environment: choice of the backend, checks of packages and memory."""

import dataclasses
from importlib.util import find_spec
from typing import Any

import torch

from knowarm.errors import UserError
from knowarm.world.backends import SimulatorName
from knowarm.world.backends.warp import import_warp, make_data
from knowarm.world.config import EnvConfig
from knowarm.world.render.tiles import EXTENT, RECORD
from knowarm.world.scene import Scene

INSTALL = "pip install 'knowarm[gpu]'"
"""Command that installs the packages a GPU needs besides torch."""

IMAGES = 3
"""Images kept per environment: the last returned, the next, and the last of its episode."""

TENSOR_BYTES = 16 * 1024
"""Draws, looks and metrics per environment and their temporaries: at most 140 draws of 8 bytes, a
dozen times."""

SHARE = 0.9
"""Part of the free memory that may be used; the rest is left for fragmentation and kernels."""


def choose_backend(device: str, simulator: str | None) -> tuple[torch.device, SimulatorName]:
    """Return the torch device and the simulator, after checking that both can be used.

    Args:
        device: "cuda", the first visible GPU, or "cpu".
        simulator: "mujoco", "warp", or None for MuJoCo on the CPU and Warp on a GPU.

    Raises:
        UserError: an unknown name, a missing package, or no usable GPU.
    """
    if device not in ("cpu", "cuda", "cuda:0"):
        raise UserError(
            f"device must be 'cuda' or 'cpu', got {device!r}. Select another GPU than the first "
            "with the environment variable CUDA_VISIBLE_DEVICES."
        )
    if simulator not in (None, "mujoco", "warp"):
        raise UserError(f"simulator must be 'mujoco', 'warp' or None, got {simulator!r}.")
    on_cpu = device == "cpu"
    if simulator == "mujoco" and not on_cpu:
        raise UserError(
            f"simulator 'mujoco' runs on the CPU, got device {device!r}. Use simulator 'warp' on a "
            "GPU, or device 'cpu'."
        )
    if on_cpu and simulator != "warp":
        return torch.device("cpu"), "mujoco"
    for package in ("mujoco_warp", "warp"):
        if find_spec(package) is None:
            raise UserError(
                f"simulator 'warp' (the one of GPUs) needs the package {package}, which is not "
                f"installed: {INSTALL}, or use device 'cpu' with simulator 'mujoco'."
            )
    if on_cpu:
        return torch.device("cpu"), "warp"
    _check_torch()
    _check_warp()
    _check_numba()
    return torch.device("cuda", 0), "warp"


def _check_torch() -> None:
    if torch.version.cuda is None:
        raise UserError(
            f"device 'cuda' needs a torch built with CUDA; torch {torch.__version__} is built "
            "without. Install one from https://pytorch.org/get-started, or use the CPU."
        )
    if not torch.cuda.is_available():
        raise UserError(
            f"device 'cuda': torch {torch.__version__} (CUDA {torch.version.cuda}) finds no GPU. "
            "`nvidia-smi` must list one, with a driver at least as new as that CUDA, and "
            "CUDA_VISIBLE_DEVICES must not hide it; or use the CPU."
        )


def _check_warp() -> None:
    warp, _ = import_warp()
    if not warp.is_cuda_available():
        version = warp.get_cuda_toolkit_version()
        toolkit = ".".join(map(str, version)) if version else "toolkit"
        raise UserError(
            f"device 'cuda': torch finds the GPU, but Warp {warp.__version__} does not. The "
            f"driver is probably older than Warp's CUDA {toolkit}: install a newer driver, or an "
            "older warp-lang."
        )


def _check_numba() -> None:
    from numba import cuda

    try:
        found = cuda.is_available()
        reason = "it finds no driver, or no CUDA toolkit to compile with"
    except Exception as error:  # whatever the driver bindings raise when they cannot be loaded
        found, reason = False, str(error)
    if not found:
        major = str(torch.version.cuda).split(".")[0]
        raise UserError(
            f"device 'cuda': Numba cannot use the GPU ({reason}). {INSTALL} installs numba-cuda, "
            "which must match the CUDA version of torch "
            f"({torch.version.cuda}): `pip install 'numba-cuda[cu{major}]'`."
        )


def memory_needed(scene: Scene, config: EnvConfig, num_envs: int) -> int:
    """Estimate the bytes that n environments take on the device, without the policy's.

    Warp's arrays are counted by allocating them on the CPU for one and for two environments. The
    temporaries of a step were measured as a fifth of them without and nine tenths with iterative
    collisions (IRB120, TIAGo); the estimate adds once their size.

    Args:
        scene: the scene to simulate.
        config: image size.
        num_envs: n.
    """
    one, two = (_data_bytes(scene, count) for count in (1, 2))
    image = 3 * config.image_size**2
    prepared = 4 * (RECORD + EXTENT) * scene.model.ngeom
    # Masks of 64 geoms per column and row of tiles, of which there are less than two per pixel.
    prepared += 8 * 2 * config.image_size * (1 + scene.model.ngeom // 64)
    each = 2 * (two - one) + IMAGES * image + prepared + TENSOR_BYTES
    return num_envs * each + 2 * (2 * one - two)


def check_memory(scene: Scene, config: EnvConfig, num_envs: int, free: int) -> None:
    """Raise an error if n environments do not fit into the free memory.

    Args:
        scene: the scene to simulate.
        config: image size.
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
        "fit, before the policy and its rollouts are allocated. Use fewer environments or smaller "
        "images, or stop other programs on the GPU."
    )


def free_memory(device: torch.device) -> int:
    """Return the free bytes of a GPU, including those cached but not used by torch."""
    free, _ = torch.cuda.mem_get_info(device)
    kept = torch.cuda.memory_reserved(device) - torch.cuda.memory_allocated(device)
    return free + kept


def _data_bytes(scene: Scene, num_envs: int) -> int:
    warp, _ = import_warp()
    with warp.ScopedDevice("cpu"):
        return _array_bytes(make_data(scene.model, num_envs))


def _array_bytes(value: Any) -> int:
    """Sum the bytes of all Warp arrays in a dataclass."""
    if dataclasses.is_dataclass(value):
        return sum(_array_bytes(getattr(value, f.name)) for f in dataclasses.fields(value))
    return int(getattr(value, "capacity", 0) or 0)


def _gigabytes(count: float) -> str:
    return f"{count / 2**30:.1f} GiB"
