"""A function of scalars goes in; one that compiles into CPU loops and CUDA kernels comes out.

Every number is float32, and no fused or reordered arithmetic is allowed: the same state must give
the same image at any batch size, on any number of threads and on either device.
"""

import hashlib
from collections.abc import Callable
from functools import update_wrapper
from pathlib import Path
from types import CellType, FunctionType
from typing import Any

import numpy as np
from numba import njit

Vector = tuple[np.float32, np.float32, np.float32]
"""Three float32 scalars; compiled code keeps them in registers."""

Matrix = tuple[np.float32, ...]
"""Nine float32 scalars, row-major."""

ZERO = np.float32(0)
HALF = np.float32(0.5)
ONE = np.float32(1)

FAR = np.float32(1e9)
"""Depth of a ray that meets nothing, and the far end of an open interval [m]."""

TINY = np.float32(1e-12)
"""Directions smaller than this count as parallel."""


def scalar(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function of scalars and tuples of scalars, to be inlined where it is called."""
    compiled: Callable[..., Any] = njit(forceinline=True, error_model="numpy")(function)
    return compiled


def entry(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function that Python calls, without the interpreter's lock, and keep it on disk.

    Numba keys its cache by the file of this function alone. What it calls lies in other files, so
    a digest of them all is put where the key takes it from: a closed-over variable.
    """
    files = sorted(Path(__file__).parent.glob("*.py"))
    digest = hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()
    code = function.__code__.replace(co_freevars=("digest",))
    keyed = FunctionType(code, function.__globals__, closure=(CellType(digest),))
    compiled: Callable[..., Any] = njit(nogil=True, cache=True, error_model="numpy")(
        update_wrapper(keyed, function)
    )
    return compiled


@scalar
def dot(a: Vector, b: Vector) -> np.float32:
    """Inner product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@scalar
def cross(a: Vector, b: Vector) -> Vector:
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@scalar
def minus(a: Vector, b: Vector) -> Vector:
    """Difference of two vectors."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@scalar
def along(origin: Vector, t: np.float32, direction: Vector) -> Vector:
    """Point at parameter t of a ray."""
    return (
        origin[0] + t * direction[0],
        origin[1] + t * direction[1],
        origin[2] + t * direction[2],
    )


@scalar
def to_local(matrix: Matrix, v: Vector) -> Vector:
    """Rotate a vector by the transpose of a row-major 3 x 3 matrix."""
    return (
        matrix[0] * v[0] + matrix[3] * v[1] + matrix[6] * v[2],
        matrix[1] * v[0] + matrix[4] * v[1] + matrix[7] * v[2],
        matrix[2] * v[0] + matrix[5] * v[1] + matrix[8] * v[2],
    )


@scalar
def to_parent(matrix: Matrix, v: Vector) -> Vector:
    """Rotate a vector by a row-major 3 x 3 matrix."""
    return (
        matrix[0] * v[0] + matrix[1] * v[1] + matrix[2] * v[2],
        matrix[3] * v[0] + matrix[4] * v[1] + matrix[5] * v[2],
        matrix[6] * v[0] + matrix[7] * v[1] + matrix[8] * v[2],
    )
