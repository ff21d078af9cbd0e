"""Scalar arithmetic: float32 vectors and the decorators that compile the ray caster's functions.

All numbers are float32 and the compiler may neither fuse nor reorder operations, so that one state
gives the same image at any batch size and on any number of threads.

Shading is MuJoCo's fixed-function shading without specular highlights: per colour channel
``rgb * (emission + sum of ambient + sum over lights of diffuse * max(0, n.l))``, at most 1. The
headlight is directional, along the camera's view, so all lights here are directions.
"""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from knowarm.compiling import njit
from knowarm.private_apis import key_numba_cache

Vector = tuple[np.float32, np.float32, np.float32]
"""Three float32 scalars, which compiled code keeps in registers."""

Matrix = tuple[np.float32, ...]  # Nine float32 scalars: a 3 x 3 matrix, row-major
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
def triple(values: NDArray[np.float32], start: int) -> Vector:
    """Read three numbers of an array."""
    return values[start], values[start + 1], values[start + 2]


@scalar
def nine(values: NDArray[np.float32], start: int) -> Matrix:
    """Read nine numbers of an array."""
    return (
        values[start], values[start + 1], values[start + 2],
        values[start + 3], values[start + 4], values[start + 5],
        values[start + 6], values[start + 7], values[start + 8],
    )  # fmt: skip


@scalar
def dot(a: Vector, b: Vector) -> np.float32:
    """Compute the inner product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@scalar
def cross(a: Vector, b: Vector) -> Vector:
    """Compute the cross product of two vectors."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@scalar
def minus(a: Vector, b: Vector) -> Vector:
    """Subtract two vectors."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@scalar
def times(a: Vector, factor: np.float32) -> Vector:
    """Multiply a vector by a scalar."""
    return a[0] * factor, a[1] * factor, a[2] * factor


@scalar
def point_at(origin: Vector, t: np.float32, direction: Vector) -> Vector:
    """Return the point at parameter t of a ray."""
    return (
        origin[0] + t * direction[0],
        origin[1] + t * direction[1],
        origin[2] + t * direction[2],
    )


@scalar
def to_local(matrix: Matrix, v: Vector) -> Vector:
    """Rotate a vector from the parent to the local frame: by the transpose of ``matrix``."""
    return (
        matrix[0] * v[0] + matrix[3] * v[1] + matrix[6] * v[2],
        matrix[1] * v[0] + matrix[4] * v[1] + matrix[7] * v[2],
        matrix[2] * v[0] + matrix[5] * v[1] + matrix[8] * v[2],
    )


@scalar
def to_parent(matrix: Matrix, v: Vector) -> Vector:
    """Rotate a vector from the local to the parent frame: by ``matrix``."""
    return (
        matrix[0] * v[0] + matrix[1] * v[1] + matrix[2] * v[2],
        matrix[3] * v[0] + matrix[4] * v[1] + matrix[5] * v[2],
        matrix[6] * v[0] + matrix[7] * v[1] + matrix[8] * v[2],
    )


FULL = np.float32(255)

Paint = tuple[Vector, Vector, Vector]
"""RGB without light, plus a half for rounding, and RGB that headlight and directional light add at
normal incidence, in 0..255."""


@scalar
def light_geom(
    rgb: Vector, emission: np.float32, lamps: tuple[Vector, Vector, Vector, Vector], matrix: Matrix
) -> tuple[Vector, Paint]:
    """Multiply a geom's colour by the light: the rows of ``read_lamps``.

    Return the unit vector towards the directional light in the geom's frame, and the paint.
    """
    ambient, head, sun, towards_sun = lamps
    r, g, b = times(rgb, FULL)
    dark = (
        r * (ambient[0] + emission) + HALF,
        g * (ambient[1] + emission) + HALF,
        b * (ambient[2] + emission) + HALF,
    )
    paint = (dark, (r * head[0], g * head[1], b * head[2]), (r * sun[0], g * sun[1], b * sun[2]))
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
    a, b = max(dot(normal, head), ZERO), max(dot(normal, sun), ZERO)
    red = _channel(dark[0] + a * by_head[0] + b * by_sun[0])
    green = _channel(dark[1] + a * by_head[1] + b * by_sun[1])
    blue = _channel(dark[2] + a * by_head[2] + b * by_sun[2])
    return np.int32(red | np.int32(green << np.int32(8)) | np.int32(blue << np.int32(16)))
