"""Arrays of NumPy and torch: namespaces, conversion, and selections of environments.

The formulas of the world are written once in the Python array API. On the CPU they run on NumPy
arrays and compute only the selected rows; on a GPU they run on torch tensors and compute all rows
with a mask, because looking up the selected rows would make the host wait for the device.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from array_api_compat import array_namespace
from numpy.typing import NDArray

Array = Any
"""A NumPy array or a torch tensor; shape and dtype are documented where it is used."""

Place = Callable[[NDArray[Any]], Array]
"""Moves a constant to where it is used: ``np.asarray``, or a copy to a device."""

__all__ = [
    "Array",
    "IndexSelection",
    "MaskSelection",
    "NumpyArrays",
    "Place",
    "Selection",
    "array_namespace",
    "here",
]


def here(array: NDArray[Any]) -> NDArray[Any]:
    """Return the array itself: the ``Place`` of NumPy."""
    return np.asarray(array)


@dataclass(frozen=True)
class IndexSelection:
    """Some of n environments by index; the m rows to compute are the selected ones."""

    env_ids: NDArray[np.intp]
    """Selected environments, (m,), each at most once."""

    @property
    def is_empty(self) -> bool:
        """Whether nothing is selected."""
        return len(self.env_ids) == 0

    def take(self, array: Array) -> Array:
        """Return the rows to compute, (n, ...) -> (m, ...)."""
        return array[self.env_ids]

    def put(self, array: Array, values: Array) -> Array:
        """Return a copy of ``array`` (n, ...) with ``values`` (m, ...) in the selected rows."""
        result = array.copy()
        result[self.env_ids] = values
        return result

    def update(self, array: Array, values: Array) -> Array:
        """Same as ``put`` for values that equal ``array`` in rows that are not selected."""
        return self.put(array, values)


@dataclass(frozen=True)
class MaskSelection:
    """Some of n environments by mask; m = n, so that no operation depends on the mask's values."""

    mask: Array
    """Selected environments, (n,) bool."""

    is_empty = False
    """Whether nothing is selected: not known without reading the mask."""

    def take(self, array: Array) -> Array:
        """Return all rows."""
        return array

    def put(self, array: Array, values: Array) -> Array:
        """Return ``values`` where the mask is set and ``array`` elsewhere."""
        rows = self.mask[(...,) + (None,) * (array.ndim - 1)]
        return array_namespace(array).where(rows, values, array)

    def update(self, array: Array, values: Array) -> Array:
        """Return ``values``, which were computed for all rows."""
        return values


Selection = IndexSelection | MaskSelection
"""A subset of environments. No method writes into its arguments."""


class NumpyArrays:
    """Where a simulator's arrays are, and in which precision: NumPy, float64, indices.

    ``TorchArrays`` in ``backends.warp`` is the other kind.
    """

    float_dtype: type[np.floating] = np.float64

    def place(self, array: NDArray[Any]) -> Array:
        """Move a host array to the device."""
        return np.asarray(array)

    def to_host(self, array: Array) -> NDArray[Any]:
        """Copy an array to the host."""
        return array.copy()

    def select(self, env_ids: NDArray[np.intp], num_envs: int) -> Selection:
        """Select environments by their indices on the host, (k,)."""
        return IndexSelection(env_ids)

    def select_where(self, mask: Array) -> Selection:
        """Select environments by a mask, (n,) bool."""
        return IndexSelection(np.flatnonzero(mask))

    def spread(self, values: NDArray[Any], env_ids: NDArray[np.intp], num_envs: int) -> Array:
        """Arrange host rows (k, ...) of environments (k,) as the selection's ``put`` takes them."""
        return values
