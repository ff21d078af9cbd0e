"""Scalar arithmetic: float32 vectors and the decorators that compile the ray caster's functions.

All numbers are float32 and the compiler may neither fuse nor reorder operations, so that one state
gives the same image at any batch size and on any number of threads.

Shading is MuJoCo's fixed-function shading without specular highlights: per colour channel
``rgb * (emission + sum of ambient + sum over lights of diffuse * max(0, n.l))``, at most 1. The
headlight is directional, along the camera's view, so all lights here are directions.
"""

import hashlib
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from knowarm.compiling import njit
from knowarm.private_apis import key_numba_cache

Floats32 = NDArray[np.float32]
Integers32 = NDArray[np.int32]
Images = NDArray[np.uint8]

Vector = tuple[np.float32, np.float32, np.float32]
"""Three float32 scalars, which compiled code keeps in registers."""

Matrix = tuple[Vector, Vector, Vector]  # Rows of a 3 x 3 matrix
ZERO = np.float32(0)
HALF = np.float32(0.5)
ONE = np.float32(1)

FAR = np.float32(1e9)
"""Depth of a ray that hits nothing, and the far end of an unbounded interval [m]."""

TINY = np.float32(1e-12)  # Direction components below this count as parallel


def scalar(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function of scalars and tuples of scalars, inlined into its caller."""
    compiled: Callable[..., Any] = njit(forceinline=True, error_model="numpy")(function)
    return compiled


def cached_njit(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function that Python calls: without the GIL, and cached on disk.

    The cache key covers all files of this folder, because the functions called lie in them.
    """
    files = sorted(Path(__file__).parent.glob("*.py"))
    digest = hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()
    compiled: Callable[..., Any] = njit(nogil=True, cache=True, error_model="numpy")(
        key_numba_cache(function, digest)
    )
    return compiled


@scalar
def vector_at(values: Floats32, start: int) -> Vector:
    """Read three numbers of an array."""
    return values[start], values[start + 1], values[start + 2]


@scalar
def matrix_at(values: Floats32, start: int) -> Matrix:
    """Read nine numbers of an array, row-major."""
    return (
        vector_at(values, start),
        vector_at(values, start + 3),
        vector_at(values, start + 6),
    )


@scalar
def dot(a: Vector, b: Vector) -> np.float32:
    """Compute the inner product of two vectors."""
    ax, ay, az = a
    bx, by, bz = b
    return ax * bx + ay * by + az * bz


@scalar
def cross(a: Vector, b: Vector) -> Vector:
    """Compute the cross product of two vectors."""
    ax, ay, az = a
    bx, by, bz = b
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@scalar
def plus(a: Vector, b: Vector) -> Vector:
    """Add two vectors."""
    ax, ay, az = a
    bx, by, bz = b
    return ax + bx, ay + by, az + bz


@scalar
def minus(a: Vector, b: Vector) -> Vector:
    """Subtract two vectors."""
    ax, ay, az = a
    bx, by, bz = b
    return ax - bx, ay - by, az - bz


@scalar
def product(a: Vector, b: Vector) -> Vector:
    """Multiply two vectors component by component."""
    ax, ay, az = a
    bx, by, bz = b
    return ax * bx, ay * by, az * bz


@scalar
def times(a: Vector, factor: np.float32) -> Vector:
    """Multiply a vector by a scalar."""
    x, y, z = a
    return x * factor, y * factor, z * factor


@scalar
def unit(a: Vector, least_square: np.float32) -> Vector:
    """Scale a vector to length 1, or to less if the square of its length is below the least."""
    return times(a, ONE / math.sqrt(max(dot(a, a), least_square)))


@scalar
def point_at(origin: Vector, t: np.float32, direction: Vector) -> Vector:
    """Return the point at parameter t of a ray."""
    return plus(origin, times(direction, t))


@scalar
def to_local(matrix: Matrix, v: Vector) -> Vector:
    """Rotate a vector from the parent to the local frame: by the transpose of ``matrix``."""
    first, second, third = matrix
    x, y, z = v
    return plus(plus(times(first, x), times(second, y)), times(third, z))


@scalar
def to_parent(matrix: Matrix, v: Vector) -> Vector:
    """Rotate a vector from the local to the parent frame: by ``matrix``."""
    first, second, third = matrix
    return dot(first, v), dot(second, v), dot(third, v)


@scalar
def transposed(matrix: Matrix) -> Matrix:
    """Return the columns of a matrix as rows."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = matrix
    return (xx, yx, zx), (xy, yy, zy), (xz, yz, zz)


FULL = np.float32(255)
HALVES = (HALF, HALF, HALF)

Paint = tuple[Vector, Vector, Vector]
"""RGB without light, plus a half for rounding, and RGB that headlight and directional light add at
normal incidence, in 0..255."""


@scalar
def light_geom(
    rgb: Vector, emission: np.float32, lamps: Floats32, matrix: Matrix
) -> tuple[Vector, Paint]:
    """Multiply a geom's colour by the light: the rows of ``read_lamps``, (12,).

    Return the unit vector towards the directional light in the geom's frame, and the paint.
    """
    ambient, head, sun = matrix_at(lamps, 0)
    towards_sun = vector_at(lamps, 9)
    colour = times(rgb, FULL)
    everywhere = plus(ambient, (emission, emission, emission))
    dark = plus(product(colour, everywhere), HALVES)
    paint = (dark, product(colour, head), product(colour, sun))
    return to_local(matrix, towards_sun), paint


@scalar
def _channel(value: np.float32) -> np.int32:
    """Convert to a byte by rounding down; the paint already holds the half that rounds."""
    return np.int32(min(value, FULL))


@scalar
def shade(normal: Vector, head: Vector, sun: Vector, paint: Paint) -> np.int32:
    """Return red, green and blue of a surface in the lowest three bytes.

    The unit vectors towards headlight and directional light are in the frame of the normal.
    """
    dark, by_head, by_sun = paint
    towards_head = max(dot(normal, head), ZERO)
    towards_sun = max(dot(normal, sun), ZERO)
    lit = plus(dark, times(by_head, towards_head))
    red, green, blue = plus(lit, times(by_sun, towards_sun))
    low = _channel(red)
    middle = np.int32(_channel(green) << np.int32(8))
    high = np.int32(_channel(blue) << np.int32(16))
    return np.int32(low | middle | high)
