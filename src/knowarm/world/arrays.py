"""Arrays of NumPy and torch: namespaces, conversion, and selections of environments.

The formulas of the world are written once in the Python array API. On the CPU they run on NumPy
arrays and compute only the selected rows; on a GPU they run on torch tensors and compute all rows
with a mask, because looking up the selected rows would make the host wait for the device.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from array_api_compat import array_namespace
from numpy.typing import NDArray

Array = Any
"""A NumPy array or a torch tensor; shape and dtype are documented where it is used."""

Place = Callable[[NDArray[Any]], Array]
"""Moves a constant to where it is used: ``np.asarray``, or a copy to a device."""

__all__ = [
    "Array",
    "ArrayBackend",
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


class Selection(Protocol):
    """A subset of n environments. No method writes into its arguments.

    ``take`` returns the m rows that have to be computed: the selected ones, or all n.
    """

    @property
    def is_empty(self) -> bool:
        """Whether nothing is selected; False where only the device knows."""
        ...

    def take(self, array: Array) -> Array:
        """Return the rows to compute, (n, ...) -> (m, ...)."""
        ...

    def put(self, array: Array, values: Array) -> Array:
        """Return a copy of ``array`` (n, ...) with ``values`` (m, ...) in the selected rows."""
        ...

    def update(self, array: Array, values: Array) -> Array:
        """Same as ``put`` for values that equal ``array`` in the rows that are not selected."""
        ...


@dataclass(frozen=True)
class IndexSelection:
    """Environments by index: m is the number of selected environments (NumPy)."""

    env_ids: NDArray[np.intp]
    """Selected environments, (m,), each at most once."""

    @property
    def is_empty(self) -> bool:
        """Whether nothing is selected."""
        return len(self.env_ids) == 0

    def take(self, array: NDArray[Any]) -> NDArray[Any]:
        """Return the selected rows, (m, ...)."""
        return array[self.env_ids]

    def put(self, array: NDArray[Any], values: Any) -> NDArray[Any]:
        """Return a copy of ``array`` with ``values`` in the selected rows."""
        result = array.copy()
        result[self.env_ids] = values
        return result

    update = put


@dataclass(frozen=True)
class MaskSelection:
    """Environments by mask: m = n, so that no operation depends on the mask's values (torch)."""

    mask: Array
    """Selected environments, (n,) bool."""

    @property
    def is_empty(self) -> bool:
        """Return False: the mask is not read."""
        return False

    def take(self, array: Array) -> Array:
        """Return all rows."""
        return array

    def put(self, array: Array, values: Array) -> Array:
        """Return ``values`` where the mask is set and ``array`` elsewhere."""
        rows = self.mask[(...,) + (None,) * (array.ndim - 1)]
        return array_namespace(array).where(rows, values, array)

    def update(self, array: Array, values: Array) -> Array:
        """Return ``values``: they were computed for all rows."""
        return values


class ArrayBackend(Protocol):
    """Where the arrays of a task are kept and in which precision poses are computed."""

    float_dtype: type[np.floating]

    def place(self, array: NDArray[Any]) -> Array:
        """Move a host array to the device; uint64 becomes int64 with the same bits in torch."""
        ...

    def to_host(self, array: Array) -> NDArray[Any]:
        """Copy an array to the host."""
        ...

    def select(self, env_ids: NDArray[np.intp], num_envs: int) -> Selection:
        """Select environments by their indices on the host, (k,)."""
        ...

    def select_where(self, mask: Array) -> Selection:
        """Select environments by a mask, (n,) bool."""
        ...

    def spread(self, values: NDArray[Any], env_ids: NDArray[np.intp], num_envs: int) -> Array:
        """Arrange host rows (k, ...) of environments (k,) as the selection's ``put`` takes them."""
        ...


class NumpyArrays:
    """``ArrayBackend`` of NumPy: float64, selections by index."""

    float_dtype = np.float64

    def place(self, array: NDArray[Any]) -> NDArray[Any]:
        """Return the array itself."""
        return np.asarray(array)

    def to_host(self, array: NDArray[Any]) -> NDArray[Any]:
        """Copy the array."""
        return array.copy()

    def select(self, env_ids: NDArray[np.intp], num_envs: int) -> IndexSelection:
        """Select environments by their indices, (k,)."""
        return IndexSelection(env_ids)

    def select_where(self, mask: NDArray[np.bool_]) -> IndexSelection:
        """Select environments by a mask, (n,) bool."""
        return IndexSelection(np.flatnonzero(mask))

    def spread(
        self, values: NDArray[Any], env_ids: NDArray[np.intp], num_envs: int
    ) -> NDArray[Any]:
        """Return the rows as they are, (k, ...)."""
        return values
