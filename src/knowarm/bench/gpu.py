"""A GPU goes in; the speed of worlds and training on it, and how near its ceilings, come out.

The same runs on the CPU device, where it says that the measuring works and nothing about a GPU.
"""

from collections.abc import Callable
from typing import Any

from knowarm.bench.gpu_config import GpuBenchConfig
from knowarm.bench.gpu_machine import describe_machine, measure_ceilings
from knowarm.bench.gpu_measure import measure_row
from knowarm.bench.gpu_rows import Row
from knowarm.config import to_dict
from knowarm.errors import UserError
from knowarm.world.gpu.device import find_device

Result = dict[str, Any]


def bench_gpu(
    config: GpuBenchConfig | None = None,
    on_row: Callable[[Result], None] = lambda result: None,
    before: Result | None = None,
) -> Result:
    """Measure environments and training on one device, one number of environments after the other.

    Args:
        config: what is measured.
        on_row: called after each row with the result so far, to be written down.
        before: a result that was cut short; what it holds is not measured again.

    Returns:
        ``machine``, ``ceilings`` (see ``measure_ceilings``), ``config`` and ``rows``, see
        ``measure_row``; ``env_steps_per_s`` and ``training_steps_per_s``, those of the best row;
        ``training_minutes_70m``, None until ``add_training`` adds a whole run.

    Raises:
        UserError: the device or a package is missing, ``before`` is of another config or machine,
            or not one row could be measured.
    """
    config = config or GpuBenchConfig()
    device = find_device(config.device)
    machine = describe_machine(device)
    kept = _kept(before, config, machine)
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
        raise UserError(f"Nothing could be measured. {result['rows'][0]['error']}")
    return result


def _summary(rows: list[Row]) -> Result:
    def best(name: str) -> float | None:
        return max((row[name] for row in rows if name in row), default=None)

    return {
        "rows": rows,
        "env_steps_per_s": best("env_steps_per_s"),
        "training_steps_per_s": best("training_steps_per_s"),
    }


def _kept(before: Result | None, config: GpuBenchConfig, machine: Result) -> Result | None:
    """Check that a result may be gone on with.

    Raises:
        UserError: it was measured with another config or on another machine.
    """
    if before is None:
        return None
    # The host's memory is left out: some machines grow it while they are used.
    facts = {name: machine[name] for name in ("gpu", "versions", "commit")}
    for name, now in {"config": to_dict(config), "machine": facts}.items():
        then = before.get(name) or {}
        other = [key for key, value in now.items() if then.get(key) != value]
        if other:
            raise UserError(
                f"The result to go on with was measured with another {name} "
                f"({', '.join(f'{key}: {then.get(key)} | {now[key]}' for key in other)}). Leave "
                "out --resume, or give --json another file."
            )
    return dict(before)
