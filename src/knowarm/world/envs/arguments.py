"""Checks of the arguments of ``step``, ``reset`` and ``set_state``."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from knowarm.errors import UserError


def checked_actions(actions: ArrayLike, shape: tuple[int, int], levels: int) -> NDArray[np.int64]:
    """Return actions as int64 of a shape (n, J)."""
    array = _checked(actions, shape, "iu", (0, levels - 1), f"integers from 0 to {levels - 1}")
    return array.astype(np.int64, copy=False)


def checked_steps(actions: ArrayLike, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return continuous actions as float64 of a shape (n, J)."""
    allowed = "floats from -1 to 1 (in units of the maximum position increment)"
    return _checked(actions, shape, "f", (-1, 1), allowed).astype(np.float64)


def _checked(
    actions: ArrayLike, shape: tuple[int, int], kinds: str, ends: tuple[int, int], allowed: str
) -> NDArray[Any]:
    array = np.asarray(actions)
    if array.shape != shape or array.dtype.kind not in kinds:
        got = f"{array.dtype} of shape {array.shape}"
    elif not ((ends[0] <= array) & (array <= ends[1])).all():
        got = f"{array.min()} to {array.max()}"
    else:
        return array
    raise UserError(
        f"actions must be {allowed} of shape {shape} (environments, joints), got {got}."
    )


def check_state(mine: dict[str, NDArray[Any]], state: dict[str, NDArray[Any]]) -> None:
    """Check that a state has arrays of the same names and shapes as the environment's own."""
    described = [
        {name: array.shape for name, array in sorted(arrays.items())} for arrays in (mine, state)
    ]
    if described[0] != described[1]:
        raise UserError(
            f"The state belongs to another environment: its arrays are {described[1]}, those of "
            f"this environment are {described[0]}. Use the same robot, targets and number of "
            "environments."
        )


def masked_ids(mask: ArrayLike | None, num_envs: int) -> NDArray[np.intp]:
    """Return the indices of a reset mask, an array or a tensor; all of them for None."""
    if mask is None:
        return np.arange(num_envs)
    array = np.asarray(mask.cpu() if hasattr(mask, "cpu") else mask)
    if array.shape != (num_envs,) or array.dtype != np.bool_ or not array.any():
        raise UserError(
            f"options['reset_mask'] must be a bool array of shape ({num_envs},) with at "
            f"least one True, got {array.dtype} of shape {array.shape}."
        )
    return np.flatnonzero(array)


def spread_seeds(
    seed: int | list[int | None] | None, num_envs: int
) -> tuple[NDArray[np.bool_], NDArray[np.uint64]]:
    """Expand Gymnasium's seed argument to one seed per environment: seed, seed + 1, ...

    Return which environments get a seed, (n,), and the seeds, 0 for the others, (n,).
    """
    if seed is None:
        seeds: list[int | None] = [None] * num_envs
    elif isinstance(seed, (int, np.integer)):
        seeds = [int(seed) + i for i in range(num_envs)]
    else:
        seeds = list(seed)
    if len(seeds) != num_envs:
        raise UserError(
            f"seed must be an integer or a list of {num_envs} (one per environment), got "
            f"{len(seeds)}."
        )
    if any(value is not None and value < 0 for value in seeds):
        raise UserError(f"seed must not be negative, got {seed}.")
    given = np.array([value is not None for value in seeds])
    return given, np.array([(value or 0) % 2**64 for value in seeds], dtype=np.uint64)
