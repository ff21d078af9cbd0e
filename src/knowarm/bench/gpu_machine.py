"""A device goes in; what it is, and how fast it copies and multiplies at best, come out."""

import subprocess
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Literal

import torch

from knowarm.bench.gpu_clock import seconds_per_call
<<<<<<< HEAD
from knowarm.experiment.run_folder import provenance
from knowarm.learn.precision import products
=======
from knowarm.experiment.run_folder import provenance
from knowarm.learn.device import tf32_products
>>>>>>> learn

PACKAGES = ("warp-lang", "mujoco-warp", "numba-cuda")
"""Packages of the device environment beside those of ``provenance``."""


def describe_machine(device: torch.device) -> dict[str, Any]:
    """Versions, commit and host as a run's provenance, with the GPU, its driver and CUDA."""
    facts = provenance()
    facts["versions"] |= {name: _version(name) for name in PACKAGES}
    facts["versions"]["cuda"] = torch.version.cuda
    if device.type != "cuda":
        return facts | {"gpu": None}
    properties = torch.cuda.get_device_properties(device)
    return facts | {
        "gpu": {
            "name": properties.name,
            "compute_capability": f"{properties.major}.{properties.minor}",
            "multiprocessors": properties.multi_processor_count,
            "memory_bytes": properties.total_memory,
            "driver": _driver(),
        }
    }


def measure_ceilings(
    device: torch.device, *, copy_bytes: int, matmul_side: int, seconds: float
) -> dict[str, float | None]:
    """Measure the rates that nothing on this device exceeds.

    Args:
        device: what is measured.
        copy_bytes: size of the array that is copied; far more than the caches hold.
        matmul_side: n of the (n, n) matrices of normal draws that are multiplied.
        seconds: time each rate is measured for, at least [s].

    Returns:
        ``copy_bytes_per_s``, bytes read and bytes written together, and
        ``<precision>_operations_per_s`` of products, 2 n^3 operations each; tf32's is None on a
        CPU, which has none.
    """
    return {
        "copy_bytes_per_s": _copy_rate(device, copy_bytes, seconds),
        "float32_operations_per_s": _product_rate(device, matmul_side, "float32", seconds),
        "tf32_operations_per_s": (
            _product_rate(device, matmul_side, "tf32", seconds) if device.type == "cuda" else None
        ),
        "bfloat16_operations_per_s": _product_rate(device, matmul_side, "bfloat16", seconds),
    }


def _copy_rate(device: torch.device, count: int, seconds: float) -> float:
    source = torch.zeros(count, dtype=torch.uint8, device=device)
    target = torch.empty_like(source)
    return _rate(lambda: target.copy_(source), 2 * count, seconds, device)


def _product_rate(
    device: torch.device,
    side: int,
    matmul_precision: Literal["float32", "tf32", "bfloat16"],
    seconds: float,
) -> float:
    kind = torch.bfloat16 if matmul_precision == "bfloat16" else torch.float32
    generator = torch.Generator(device).manual_seed(0)
    a, b = (torch.randn(side, side, generator=generator, device=device).to(kind) for _ in range(2))
    out = torch.empty_like(a)
    with tf32_products(matmul_precision, device):
        return _rate(lambda: torch.mm(a, b, out=out), 2 * side**3, seconds, device)


def _rate(run: Callable[[], Any], amount: int, seconds: float, device: torch.device) -> float:
    """Amount a second, where every call of ``run`` does that amount."""
    for _ in range(3):
        run()
    return amount / seconds_per_call(run, seconds, device)


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _driver() -> str | None:
    """Version of the GPU's driver, as ``nvidia-smi`` tells it."""
    command = ["nvidia-smi", "--query-gpu=driver_version", "--format=csv,noheader"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.splitlines()[0].strip()
