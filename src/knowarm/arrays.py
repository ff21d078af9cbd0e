"""Types of NumPy arrays by what they hold; docstrings give their shapes and units."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]
Names = NDArray[np.str_]
