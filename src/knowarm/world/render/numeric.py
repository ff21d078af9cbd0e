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

from numpy import float32, int32
from numpy.typing import NDArray

from knowarm.arrays import Floats32
from knowarm.compiling import njit
from knowarm.private_apis import key_numba_cache

Integers32 = NDArray[int32]

Vector = tuple[float32, float32, float32]
"""Three float32 scalars, which compiled code keeps in registers."""

Matrix = tuple[Vector, Vector, Vector]  # Rows of a 3 x 3 matrix
ZERO = float32(0)
HALF = float32(0.5)
ONE = float32(1)

FAR = float32(1e9)
"""Depth of a ray that hits nothing, and the far end of an unbounded interval [m]."""

TINY = float32(1e-12)  # Direction components below this count as parallel


Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]

scalar: Decorator = njit(forceinline=True, error_model="numpy")
"""Compile a function of scalars and tuples of scalars, inlined into its caller."""
kernel: Decorator = njit(error_model="numpy")
"""Compile a function that only compiled code calls."""


def cached_njit(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function that Python calls: without the GIL, and cached on disk.

    The cache key covers all files of this folder, because the functions called lie in them.
    """
    files = sorted(Path(__file__).parent.glob("*.py"))
    digest = hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()
    compiler: Decorator = njit(nogil=True, cache=True, error_model="numpy")
    return compiler(key_numba_cache(function, digest))


@scalar
def vector_at(values: Floats32, start: int) -> Vector:
    """Read three numbers of an array."""
    return values[start], values[start + 1], values[start + 2]


@scalar
def write_vector(values: Floats32, start: int, v: Vector) -> None:
    """Write three numbers to an array."""
    values[start], values[start + 1], values[start + 2] = v


@scalar
def matrix_at(values: Floats32, start: int) -> Matrix:
    """Read nine numbers of an array, row-major."""
    return (
        vector_at(values, start),
        vector_at(values, start + 3),
        vector_at(values, start + 6),
    )


@scalar
def write_matrix(values: Floats32, start: int, matrix: Matrix) -> None:
    """Write nine numbers to an array, row-major."""
    for i in range(3):
        write_vector(values, start + 3 * i, matrix[i])


@scalar
def dot(a: Vector, b: Vector) -> float32:
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
def times(a: Vector, factor: float32) -> Vector:
    """Multiply a vector by a scalar."""
    x, y, z = a
    return x * factor, y * factor, z * factor


@scalar
def unit(a: Vector, least_square: float32) -> Vector:
    """Scale a vector to length 1, or to less if the square of its length is below the least."""
    return times(a, ONE / math.sqrt(max(dot(a, a), least_square)))


@scalar
def point_at(origin: Vector, t: float32, direction: Vector) -> Vector:
    """Return the point at parameter t of a ray."""
    return plus(origin, times(direction, t))


@scalar
def to_local(matrix: Matrix, v: Vector) -> Vector:
    """Rotate a vector from the parent to the local frame: by the transpose of ``matrix``."""
    return to_parent(transposed(matrix), v)


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


FULL = float32(255)
HALVES = (HALF, HALF, HALF)

Paint = Matrix
"""RGB without light, plus a half for rounding, and RGB that headlight and directional light add at
normal incidence, in 0..255."""


@scalar
def light_geom(
    rgb: Vector, emission: float32, lamps: Floats32, matrix: Matrix
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
def shade(normal: Vector, head: Vector, sun: Vector, paint: Paint) -> int32:
    """Return red, green and blue of a surface in the lowest three bytes.

    The unit vectors towards headlight and directional light are in the frame of the normal.
    """
    dark, by_head, by_sun = paint
    towards_head = max(dot(normal, head), ZERO)
    towards_sun = max(dot(normal, sun), ZERO)
    lit = plus(dark, times(by_head, towards_head))
    red, green, blue = plus(lit, times(by_sun, towards_sun))
    # The paint already holds the half that rounds.
    low = int32(min(red, FULL))
    middle = int32(int32(min(green, FULL)) << int32(8))
    high = int32(int32(min(blue, FULL)) << int32(16))
    return int32(low | middle | high)
