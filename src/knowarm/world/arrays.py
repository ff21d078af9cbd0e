"""What holds numbers goes in; one way to compute with them, NumPy's or torch's, comes out.

The functions that draw and show episodes serve both devices: they take NumPy arrays on the CPU and
torch tensors on a GPU, and compute in the array API's words for either.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from array_api_compat import array_namespace
from numpy.typing import NDArray

Array = Any
"""A NumPy array or a torch tensor; shape and dtype stand where it is used."""

Place = Callable[[NDArray[Any]], Array]
"""Puts a constant where the computing happens: ``np.asarray``, or a copy to a device."""

__all__ = ["Array", "Place", "array_namespace", "here"]


def here(array: NDArray[Any]) -> NDArray[Any]:
    """The ``Place`` of the CPU: leave an array where it is."""
    return np.asarray(array)
