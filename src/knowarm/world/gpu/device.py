"""A device's name goes in; the torch device comes out, once everything that it needs was found."""

import importlib
from importlib.util import find_spec
from typing import Any

import torch

from knowarm.errors import UserError

INSTALL = "pip install 'knowarm[gpu]'"
"""What brings the packages a GPU needs beside torch."""


def find_device(name: str) -> torch.device:
    """Return the torch device of this name, ready for torch, Warp and Numba.

    Args:
        name: "cuda", the first visible GPU, or "cpu", which is slow and for checking.

    Raises:
        UserError: another name, a package is missing, or a library finds no GPU that it can use.
    """
    if name not in ("cpu", "cuda", "cuda:0"):
        raise UserError(
            f"device must be 'cuda' or 'cpu', got {name!r}. Another GPU than the first is chosen "
            "with the environment variable CUDA_VISIBLE_DEVICES."
        )
    for package in ("mujoco_warp", "warp"):
        if find_spec(package) is None:
            raise UserError(
                f"The device environment steps with MuJoCo Warp, and the package {package} is not "
                f"installed: {INSTALL}, or leave out device for the NumPy environment."
            )
    if name == "cpu":
        return torch.device("cpu")
    _check_torch()
    _check_warp()
    _check_numba()
    return torch.device("cuda", 0)


def import_warp() -> tuple[Any, Any]:
    """Import Warp and MuJoCo Warp without their reports on the terminal."""
    warp = importlib.import_module("warp")
    warp.config.log_level = warp.LOG_WARNING
    warp.init()
    return warp, importlib.import_module("mujoco_warp")


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
        raise UserError(
            f"device 'cuda': torch finds the GPU, but Warp {warp.__version__} does not. Most "
            f"likely the driver is older than Warp's CUDA {_warp_cuda(warp)}: install a newer "
            "driver, or an older warp-lang."
        )


def _warp_cuda(warp: Any) -> str:
    version = warp.get_cuda_toolkit_version()
    return ".".join(map(str, version)) if version else "toolkit"


def _check_numba() -> None:
    from numba import cuda

    try:
        found = cuda.is_available()
        reason = "it finds no driver, or no CUDA toolkit to compile with"
    except Exception as error:  # whatever the driver bindings raise when they cannot be loaded
        found, reason = False, str(error)
    if not found:
        raise UserError(
            f"device 'cuda': Numba cannot use the GPU ({reason}). {INSTALL} brings numba-cuda, "
            "which must be of the same CUDA version as torch "
            f"({torch.version.cuda}): `pip install 'numba-cuda[cu{_major()}]'`."
        )


def _major() -> str:
    return str(torch.version.cuda).split(".")[0]
