"""Benchmark of simulation and training on one GPU (`knowarm bench gpu`).

On device "cpu" it runs as well, to check the benchmark itself; those results say nothing about a
GPU.
"""

import subprocess
from collections.abc import Callable
from typing import Any

import torch

from knowarm.bench.clock import seconds_per_call
from knowarm.bench.gpu_measure import Ceilings, GpuBenchConfig, measure_row
from knowarm.bench.learn import Row
from knowarm.config import to_dict
from knowarm.errors import UserError
from knowarm.experiment.run_folder import package_version, provenance
from knowarm.learn.device import tf32_products
from knowarm.policy.policy import MatmulPrecision
from knowarm.world.backends.device import choose_backend

Result = dict[str, Any]
"""Result of the GPU benchmark, see ``bench_gpu``."""

PACKAGES = ("warp-lang", "mujoco-warp", "numba-cuda")
"""Packages of the GPU environment whose versions are stored beside those of ``provenance``."""


def bench_gpu(
    config: GpuBenchConfig | None = None,
    on_row: Callable[[Result], None] = lambda result: None,
    before: Result | None = None,
) -> Result:
    """Measure environments and training on one device for several numbers of environments.

    Args:
        config: what to measure.
        on_row: called after each row with the result so far, for saving it.
        before: result of an interrupted call; its rows are not measured again.

    Returns:
        ``machine``, ``ceilings`` (see ``measure_ceilings``), ``config`` and ``rows`` (see
        ``measure_row``); ``env_steps_per_s`` and ``training_steps_per_s``, the best of all rows;
        ``training`` and ``training_minutes_70m``, None until ``benchmarks/gpu.sh`` adds a run.

    Raises:
        UserError: the device or a package is missing, ``before`` is of another config or machine,
            or no row could be measured.
    """
    config = config or GpuBenchConfig()
    device, _ = choose_backend(config.device, "warp")
    machine = describe_machine(device)
    kept = _check_before(before, config, machine)
    result = kept or {"training": None, "training_minutes_70m": None}
    if kept is None:
        result["ceilings"] = measure_ceilings(
            device,
            copy_bytes=config.copy_bytes,
            matmul_side=config.matmul_side,
            seconds=min(1.0, config.seconds),
        )
    result |= {"machine": machine, "config": to_dict(config)}
    rows = {row["num_envs"]: row for row in result.get("rows", ()) if not row["error"]}
    for num_envs in config.num_envs:
        if num_envs not in rows:
            rows[num_envs] = measure_row(config, num_envs, result["ceilings"], device)
        result |= _summary([rows[count] for count in config.num_envs if count in rows])
        on_row(result)
    if result["env_steps_per_s"] is None:
        raise UserError(f"No row could be measured. {result['rows'][0]['error']}")
    return result


def _summary(rows: list[Row]) -> Result:
    def best(name: str) -> float | None:
        return max((row[name] for row in rows if name in row), default=None)

    names = ("env_steps_per_s", "training_steps_per_s")
    return {"rows": rows} | {name: best(name) for name in names}


def _check_before(before: Result | None, config: GpuBenchConfig, machine: Result) -> Result | None:
    """Return the result of an interrupted call, if it may be continued.

    Raises:
        UserError: it was measured with another config or on another machine.
    """
    if before is None:
        return None
    # The size of the host's memory is not compared: on some machines it grows with use.
    facts = {name: machine[name] for name in ("gpu", "versions", "commit")}
    for name, now in {"config": to_dict(config), "machine": facts}.items():
        then = before.get(name) or {}
        other = [key for key, value in now.items() if then.get(key) != value]
        if other:
            pairs = ", ".join(f"{key}: {then.get(key)} | {now[key]}" for key in other)
            raise UserError(
                f"The stored result was measured with another {name} (stored | now: {pairs}) and "
                "cannot be continued. Start a new result file."
            )
    return dict(before)


def describe_machine(device: torch.device) -> dict[str, Any]:
    """Return versions, commit and host as in a run's provenance, with GPU, driver and CUDA."""
    facts = provenance()
    facts["versions"] |= {name: package_version(name) for name in PACKAGES}
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
) -> Ceilings:
    """Measure the peak rates of a device.

    Args:
        device: device to measure.
        copy_bytes: size of the copied array; choose far more than the caches hold.
        matmul_side: n of the (n, n) matrices of standard normal values that are multiplied.
        seconds: minimum measuring time per rate [s].

    Returns:
        ``copy_bytes_per_s``, bytes read plus bytes written, and
        ``<precision>_operations_per_s`` of matrix products, counting 2 n^3 operations each;
        None for tf32 on a CPU, which does not support it.
    """
    ceilings: Ceilings = {"copy_bytes_per_s": _copy_rate(device, copy_bytes, seconds)}
    precisions: tuple[MatmulPrecision, ...] = ("float32", "tf32", "bfloat16")
    for precision in precisions:
        missing = precision == "tf32" and device.type != "cuda"
        rate = None if missing else _product_rate(device, matmul_side, precision, seconds)
        ceilings[f"{precision}_operations_per_s"] = rate
    return ceilings


def _copy_rate(device: torch.device, count: int, seconds: float) -> float:
    source = torch.zeros(count, dtype=torch.uint8, device=device)
    target = torch.empty_like(source)
    return _rate(lambda: target.copy_(source), 2 * count, seconds, device)


def _product_rate(
    device: torch.device, side: int, precision: MatmulPrecision, seconds: float
) -> float:
    dtype = torch.bfloat16 if precision == "bfloat16" else torch.float32
    generator = torch.Generator(device).manual_seed(0)
    a, b = (torch.randn(side, side, generator=generator, device=device).to(dtype) for _ in range(2))
    out = torch.empty_like(a)
    with tf32_products(precision, device):
        return _rate(lambda: torch.mm(a, b, out=out), 2 * side**3, seconds, device)


def _rate(run: Callable[[], Any], amount: int, seconds: float, device: torch.device) -> float:
    """Measure the amount per second, where each call of ``run`` processes ``amount``."""
    for _ in range(3):
        run()
    return amount / seconds_per_call(run, seconds, device)


def _driver() -> str | None:
    """Return the version of the GPU's driver as reported by ``nvidia-smi``."""
    command = ["nvidia-smi", "--query-gpu=driver_version", "--format=csv,noheader"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.splitlines()[0].strip()
