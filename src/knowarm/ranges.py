"""Ranges of the numbers in configs, by the names of their fields."""

import math
from functools import cache
from typing import Any

from knowarm.errors import UserError

MAX_SEED = 2**63 - 1
"""Largest seed: PyTorch's generators take no larger one."""

LEAST = 1e-12
"""Smallest size of a floating-point number that is not 0."""
MOST_INT = 1e5
"""Largest size of integers without an entry in `RANGES`."""
MOST_FLOAT = 1e6
"""Largest size of such floating-point numbers."""
_COUNT = (1, 1e5)
_COUNT_OR_NONE = (0, 1e5)
_SHARE = (0, 1)
RANGES: dict[str, tuple[float, float]] = {
    # Counts of steps, images and episodes
    "steps": (1, 1e6),
    "total_steps": (1, 1e12),
    "every_steps": (1, 1e12),
    "confirm_steps": (0, 1e6),
    "following_steps": (LEAST, 1e6),
    "images": (1, 1e9),
    "episodes": (1, 1e8),
    "blind_episodes": (0, 1e8),
    # Other counts
    "hidden": (1, 1e6),
    "n3": (0, 1e6),
    "factor": (1, 1e3),
    "at_once": _COUNT,
    "batch": _COUNT,
    "batch_size": _COUNT,
    "cores": _COUNT,
    "dim": _COUNT,
    "envs_per_worker": _COUNT,
    "epochs": _COUNT,
    "evaluate_every": _COUNT,
    "evaluations": _COUNT,
    "features": _COUNT,
    "joints": _COUNT,
    "levels": _COUNT,
    "minibatches": _COUNT,
    "negatives": _COUNT,
    "num_envs": _COUNT,
    "objects": _COUNT,
    "objects_per_episode": _COUNT,
    "patience": _COUNT,
    "processes": _COUNT,
    "slots": _COUNT,
    "threads": _COUNT,
    "training_seeds": _COUNT,
    "trial": _COUNT,
    "workers": _COUNT,
    "degree": _COUNT_OR_NONE,
    "hops": _COUNT_OR_NONE,
    "knowledge_dim": _COUNT_OR_NONE,
    "retries": _COUNT_OR_NONE,
    "rounds": _COUNT_OR_NONE,
    "scene": _COUNT_OR_NONE,
    "scenes": _COUNT_OR_NONE,
    "start_joints": _COUNT_OR_NONE,
    # Shares of one
    "gamma": _SHARE,
    "gpus": _SHARE,
    "lambda": _SHARE,
    "learning_rate_final": _SHARE,
    "share": _SHARE,
    "start_fraction": _SHARE,
    "until": _SHARE,
    "success": (LEAST, 1),
    # Numbers of learning
    "clip_range": (LEAST, 10),
    "coef": (0, 1e6),
    "eps": (LEAST, 1e6),
    "gain": (LEAST, 1e4),
    "grad_norm": (LEAST, 1e6),
    "learning_rate": (LEAST, 10),
    "norm": (-1e6, 1e6),
    "pixel_scale": (LEAST, 1e4),
    "reward_scale": (LEAST, 1e4),
    "scale": (-1e4, 1e4),
    "threshold_decrease": (0, 1e6),
    # Quantities by their unit
    "deg": (-360, 360),
    "angle_deg": (LEAST, 360),
    "fovy_deg": (LEAST, 179),
    "light_angle_deg": (0, 360),
    "rad": (-100, 100),
    "mpi_rad": (LEAST, 100),
    "m": (-1e3, 1e3),
    "distance_m": (LEAST, 2),
    "gripper_step_m": (LEAST, 1e3),
    "half_size_m": (0, 1e3),
    "kg": (-1e3, 1e3),
    "s": (LEAST, 1e6),
    "hz": (LEAST, 1e4),
    "gib": (LEAST, 1e6),
}
"""Least and largest number of a field, by the last words of its name: what it counts, or its unit.
The entry with the most words applies."""

LARGEST_SHOWN = 1e300
"""Size above which Python may refuse to print an integer."""


def check_number(value: int | float, name: str, where: str) -> None:
    """Check that a number is finite and, where it is that of a field ``name``, in its range.

    A seed is one that generators take. ``where`` is its path, for errors.
    """
    if isinstance(value, float) and not math.isfinite(value):
        raise UserError(f"{where} must be a finite number, got {value}.")
    if where.endswith(".seed"):
        if not 0 <= value <= MAX_SEED:
            raise UserError(f"{where} must lie between 0 and 2**63 - 1, got {value}.")
    elif name:
        most = MOST_FLOAT if isinstance(value, float) else MOST_INT
        _check_range(value, _range(name) or (-most, most), where)


def _check_range(value: Any, ends: tuple[float, float], path: str) -> None:
    least, most = ends
    is_tiny = 0 < abs(value) < LEAST
    if least <= value <= most and not is_tiny:
        return
    if least == 0 and most == 1:
        allowed = "between 0 and 1"
    elif abs(value) > most:
        allowed = f"at most {most:g} in size"
    elif least == LEAST and value <= 0:
        allowed = "larger than 0"
    elif value < least:
        allowed = f"at least {least:g}"
    else:
        allowed = f"0, or at least {LEAST:g} in size"
    shown_value = f"{value}" if abs(value) < LARGEST_SHOWN else "a larger number"
    raise UserError(f"{path} must be {allowed}, got {shown_value}.")


@cache
def _range(name: str) -> tuple[float, float] | None:
    """Return the entry of `RANGES` with the most last words of a field's name."""
    words = name.split("_")
    for first in range(len(words)):
        ends = RANGES.get("_".join(words[first:]))
        if ends is not None:
            return ends
    return None


def within(config: Any, least: float, most: float, name: str, where: str = "") -> None:
    """Check that a field of a config, where it is not None, is a number in a range."""
    value = getattr(config, name)
    is_number = isinstance(value, int | float)
    if value is not None and not (is_number and least <= value <= most):
        raise UserError(
            f"{where}{name} must be between {least:g} and {most:g}, got {value!r}."
        )
