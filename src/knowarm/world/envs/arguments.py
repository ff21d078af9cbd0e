"""Checks of the arguments of ``reset`` and ``set_state``."""

from operator import index
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from knowarm.arrays import Indices, Mask
from knowarm.errors import UserError
from knowarm.world.tasks.sampling import Words
from knowarm.world.tasks.state import NamedArrays

Seeds = int | list[int | None] | None
"""Seed of the first environment, one per environment, or none."""

Options = dict[str, Any]
"""Options of an environment or of its reset, by name."""


def check_state(mine: NamedArrays, state: NamedArrays) -> None:
    """Check that a state has arrays of the same names and shapes as the environment's own."""
    expected = {name: array.shape for name, array in sorted(mine.items())}
    got = {name: array.shape for name, array in sorted(state.items())}
    if got != expected:
        raise UserError(
            f"The state belongs to another environment: its arrays are {got}, those of "
            f"this environment are {expected}. Use the same robot, targets and number of "
            "environments."
        )


def masked_ids(mask: ArrayLike | None, num_envs: int) -> Indices:
    """Return the indices of a reset mask, an array or a tensor; all of them for None."""
    if mask is None:
        return np.arange(num_envs)
    if hasattr(mask, "cpu"):
        mask = mask.cpu()
    array = np.asarray(mask)
    if array.shape != (num_envs,) or array.dtype != np.bool_ or not array.any():
        raise UserError(
            f"options['reset_mask'] must be a bool array of shape ({num_envs},) with at "
            f"least one True, got {array.dtype} of shape {array.shape}."
        )
    return np.flatnonzero(array)


def spread_seeds(seed: Seeds, num_envs: int) -> tuple[Mask, Words]:
    """Expand Gymnasium's seed argument to one seed per environment: seed, seed + 1, ...

    Return which environments get a seed, (n,), and the seeds, 0 for the others, (n,).
    """
    seeds: Any = seed
    if seed is None:
        seeds = np.full(num_envs, None)
    elif isinstance(seed, int | np.integer):
        seeds = range(int(seed), int(seed) + num_envs)
    values = np.atleast_1d(np.array(seeds, object))
    is_seeded = np.not_equal(values, np.array(None))
    values[~is_seeded] = 0
    allowed = f"an integer or a list of {num_envs} (one per environment)"
    try:
        integers = np.array([*map(index, values)], object)
    except TypeError:
        raise UserError(f"seed must be {allowed}, got {seed!r}.") from None
    if len(integers) != num_envs:
        raise UserError(f"seed must be {allowed}, got {len(integers)}.")
    if (integers < 0).any():
        raise UserError(f"seed must not be negative, got {seed}.")
    return is_seeded, (integers % 2**64).astype(np.uint64)
