"""Types of NumPy arrays by what they hold; docstrings give their shapes and units."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]
Names = NDArray[np.str_]
Images = NDArray[np.uint8]
Floats32 = NDArray[np.float32]
Indices = NDArray[np.intp]
Array = NDArray[Any]
