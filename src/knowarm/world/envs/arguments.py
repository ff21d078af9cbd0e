"""Checks of the arguments of ``step``, ``reset`` and ``set_state``."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from knowarm.arrays import Floats, Integers, Mask
from knowarm.errors import UserError
from knowarm.world.tasks.sampling import Words
from knowarm.world.tasks.state import Indices, NamedArrays


def checked_actions(
    actions: ArrayLike, shape: tuple[int, int], levels: int
) -> Integers:
    """Return actions as int64 of a shape (n, J)."""
    last = levels - 1
    array = _checked(actions, shape, "iu", 0, last, f"integers from 0 to {last}")
    return array.astype(np.int64, copy=False)


def checked_steps(actions: ArrayLike, shape: tuple[int, int]) -> Floats:
    """Return continuous actions as float64 of a shape (n, J)."""
    allowed = "floats from -1 to 1 (in units of the maximum position increment)"
    return _checked(actions, shape, "f", -1, 1, allowed).astype(np.float64)


def _checked(
    actions: ArrayLike,
    shape: tuple[int, int],
    kinds: str,
    lowest: int,
    highest: int,
    allowed: str,
) -> NDArray[Any]:
    """Return actions as an array of a shape, a kind of dtype and a range."""
    array = np.asarray(actions)
    if array.shape != shape or array.dtype.kind not in kinds:
        got = f"{array.dtype} of shape {array.shape}"
    elif not ((lowest <= array) & (array <= highest)).all():
        got = f"{array.min()} to {array.max()}"
    else:
        return array
    raise UserError(
        f"actions must be {allowed} of shape {shape} (environments, joints), got {got}."
    )


def check_state(mine: NamedArrays, state: NamedArrays) -> None:
    """Check that a state has arrays of the same names and shapes as the environment's own."""
    expected = _shapes(mine)
    got = _shapes(state)
    if got != expected:
        raise UserError(
            f"The state belongs to another environment: its arrays are {got}, those of "
            f"this environment are {expected}. Use the same robot, targets and number of "
            "environments."
        )


def _shapes(arrays: NamedArrays) -> dict[str, tuple[int, ...]]:
    return {name: array.shape for name, array in sorted(arrays.items())}


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


def spread_seeds(
    seed: int | list[int | None] | None, num_envs: int
) -> tuple[Mask, Words]:
    """Expand Gymnasium's seed argument to one seed per environment: seed, seed + 1, ...

    Return which environments get a seed, (n,), and the seeds, 0 for the others, (n,).
    """
    seeds: list[int | None]
    if seed is None:
        seeds = [None] * num_envs
    elif isinstance(seed, int | np.integer):
        seeds = list(range(int(seed), int(seed) + num_envs))
    else:
        seeds = list(seed)
    if len(seeds) != num_envs:
        raise UserError(
            f"seed must be an integer or a list of {num_envs} (one per environment), got "
            f"{len(seeds)}."
        )
    is_seeded = np.zeros(num_envs, dtype=np.bool_)
    words = np.zeros(num_envs, dtype=np.uint64)
    for i, value in enumerate(seeds):
        if value is None:
            continue
        if value < 0:
            raise UserError(f"seed must not be negative, got {seed}.")
        is_seeded[i] = True
        words[i] = value % 2**64
    return is_seeded, words
