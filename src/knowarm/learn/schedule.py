"""A share of the training goes in; the step size at that point comes out."""

import math
from typing import Literal

Schedule = Literal["constant", "linear", "cosine"]


def step_size(schedule: Schedule, start: float, final_share: float, progress: float) -> float:
    """Step size after a share ``progress`` (0..1) of the training.

    Falls from ``start`` to ``final_share * start`` along a line or half a cosine, or stays.
    """
    progress = min(max(progress, 0.0), 1.0)
    if schedule == "constant":
        return start
    remaining = 1 - progress if schedule == "linear" else 0.5 * (1 + math.cos(math.pi * progress))
    return start * (final_share + (1 - final_share) * remaining)
