"""Tiles: the samples of an image, and the rectangle of samples that a geom's projection covers.

An image of H x W pixels with S samples per pixel is a field of H * S rows of W samples. Rows are
evenly spaced, ``pixel / S`` apart; with four samples every row is shifted sideways so that the
samples of a pixel have four different heights and four different horizontal positions (a rotated
grid):

    row 4j        . x . .
    row 4j + 1    . . . x
    row 4j + 2    x . . .
    row 4j + 3    . . x .

Samples are stored by strips of ``TILE`` columns, as (strips, rows, TILE) numbers, so that tiles
above each other are contiguous in memory.

Camera frame: x right, y up, looking along -z. Image coordinates are X = x / -z and Y = y / -z. A
rectangle is (X lower, X upper, Y lower, Y upper); ``EVERYWHERE`` stands for geoms that reach behind
the camera. All other rectangles are the exact bounds of the projection: sphere, ellipsoid and disc
are sets {p + M u, |u| <= 1}, which the plane x + X z = 0 through the eye touches where
(n.p)^2 = n.A.n with n = (1, 0, X) and A = M M', a quadratic in X. Capsule and cylinder are the
convex hulls of two spheres and of two discs.

Kernels store a projected geom as ``RECORD`` float32 and ``EXTENT`` int32 numbers:

    record  origin 3 | frame 9 | size 3 | towards sun 3 | paint 9
    extent  kind | geom | first and last column | first and last row of samples

``origin`` is the eye and ``towards sun`` a direction in the geom's frame, ``frame`` the row-major
rotation from geom to camera. The headlight shines along the view, so the direction towards it is
camera z, the last row of ``frame``.
"""

import math
from typing import NamedTuple

import numpy as np

from knowarm.world.render.intersections import (
    BOX,
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    MESH,
    PLANE,
    SPHERE,
)
from knowarm.world.render.numeric import (
    FAR,
    ONE,
    ZERO,
    Matrix,
    Vector,
    minus,
    scalar,
    to_local,
    to_parent,
)

TILE, BITS = 4, 2  # Side of a tile of samples, a power of two, and its exponent
ANTIALIASING = 4  # Samples per pixel with anti-aliasing
SLACK = np.float32(0.02)
"""Fraction of a pixel or row by which a rectangle is widened against rounding."""

RECORD, EXTENT = 27, 6  # Numbers stored per projected geom
NEAR = np.float32(1e-3)  # Points closer to the eye than this have no useful projection [m]
Rectangle = tuple[np.float32, np.float32, np.float32, np.float32]

WIDE = np.float32(1e6)
EVERYWHERE = (-WIDE, WIDE, -WIDE, WIDE)


class TileGrid(NamedTuple):
    """Positions of the samples in image coordinates."""

    left: np.float32  # X of the centre of the first pixel
    top: np.float32  # Y of the first row
    pixel: np.float32  # Width of a pixel
    step: np.float32  # Distance between rows, ``pixel / S``
    mask: np.int32  # S - 1; row & mask is the index of the sample within its pixel
    shift: np.float32  # Horizontal offset of sample 0 from the centre of the pixel
    advance: np.float32  # Horizontal distance from one sample to the next
    # Horizontal distance back before sample 2, so that sample 3 stays inside the pixel
    back: np.float32
    reach: np.float32  # Largest horizontal distance of a sample from the centre, in pixels
    strips: np.int32  # Number of strips of ``TILE`` columns that hold the image
    rows: np.int32  # Number of rows of samples, a multiple of ``TILE``


def make_grid(width: int, height: int, half_height: float, samples: int) -> TileGrid:
    """Lay out 1 or ``ANTIALIASING`` samples per pixel; ``half_height`` is tan(fovy / 2)."""
    pixel = 2 * half_height / height
    # In quarters of a pixel: sample s of four lies at 2 s - .5, less 5 from sample 2 on.
    shift, advance, back = {1: (0, 0, 0), ANTIALIASING: (-0.5, 2, 5)}[samples]
    return TileGrid(
        left=np.float32((1 - width) / 2 * pixel),
        top=np.float32(half_height - pixel / samples / 2),
        pixel=np.float32(pixel),
        step=np.float32(pixel / samples),
        mask=np.int32(samples - 1),
        shift=np.float32(shift * pixel / 4),
        advance=np.float32(advance * pixel / 4),
        back=np.float32(back * pixel / 4),
        reach=np.float32({1: 0.0, ANTIALIASING: 0.375}[samples]),
        strips=np.int32(-(-width // TILE)),
        rows=np.int32(-(-height * samples // TILE) * TILE),
    )


@scalar
def sample_point(column: np.int32, row: np.int32, grid: TileGrid) -> tuple[np.float32, np.float32]:
    """Return X and Y of the sample in a pixel column and a row of samples."""
    s = np.int32(row & grid.mask)
    half = np.int32(s >> np.int32(1))
    aside = grid.shift + np.float32(s) * grid.advance - np.float32(half) * grid.back
    x = grid.left + np.float32(column) * grid.pixel + aside
    return x, grid.top - np.float32(row) * grid.step


@scalar
def sample_direction(x: np.float32, y: np.float32, frame: Matrix) -> Vector:
    """Return the direction of the ray through image coordinates x, y in a geom's frame."""
    return (
        x * frame[0] + y * frame[3] - frame[6],
        x * frame[1] + y * frame[4] - frame[7],
        x * frame[2] + y * frame[5] - frame[8],
    )


@scalar
def _floor(value: np.float32) -> np.int32:
    """Round down, clamped to what an integer can hold."""
    return np.int32(math.floor(min(max(value, -FAR), FAR)))


@scalar
def first_sample(distance: np.float32, step: np.float32, reach: np.float32) -> int:
    """Return the index of the first sample beyond a distance from sample 0, less ``SLACK``."""
    return _floor(distance / step - SLACK - reach) + 1


@scalar
def last_sample(distance: np.float32, step: np.float32, reach: np.float32) -> int:
    """Return the index of the last sample within a distance from sample 0, plus ``SLACK``."""
    return _floor(distance / step + SLACK + reach)


@scalar
def _interval(
    p: np.float32, pz: np.float32, a_xx: np.float32, a_xz: np.float32, a_zz: np.float32
) -> tuple[np.float32, np.float32]:
    """Bound x / -z over {p + M u}, all of it in front of the eye."""
    a = pz * pz - a_zz
    b = p * pz - a_xz
    root = math.sqrt(max(b * b - a * (p * p - a_xx), ZERO))
    inverse = ONE / a
    return (-b - root) * inverse, (-b + root) * inverse


@scalar
def _round_bounds(p: Vector, m: Matrix, axes: Vector) -> Rectangle:
    """Bound an ellipsoid of half-axes ``axes`` (0 for a disc) at p with rotation m."""
    x, y, z = axes[0] * axes[0], axes[1] * axes[1], axes[2] * axes[2]
    a_zz = m[6] * m[6] * x + m[7] * m[7] * y + m[8] * m[8] * z
    if p[2] + math.sqrt(a_zz) > -NEAR:
        return EVERYWHERE
    a_xx = m[0] * m[0] * x + m[1] * m[1] * y + m[2] * m[2] * z
    a_yy = m[3] * m[3] * x + m[4] * m[4] * y + m[5] * m[5] * z
    a_xz = m[0] * m[6] * x + m[1] * m[7] * y + m[2] * m[8] * z
    a_yz = m[3] * m[6] * x + m[4] * m[7] * y + m[5] * m[8] * z
    x0, x1 = _interval(p[0], p[2], a_xx, a_xz, a_zz)
    y0, y1 = _interval(p[1], p[2], a_yy, a_yz, a_zz)
    return x0, x1, y0, y1


@scalar
def _long_bounds(p: Vector, m: Matrix, half: np.float32, end: Vector) -> Rectangle:
    """Bound the convex hull of two equal round ends at +-half along the local z axis."""
    dx, dy, dz = m[2] * half, m[5] * half, m[8] * half
    a = _round_bounds((p[0] + dx, p[1] + dy, p[2] + dz), m, end)
    b = _round_bounds((p[0] - dx, p[1] - dy, p[2] - dz), m, end)
    return min(a[0], b[0]), max(a[1], b[1]), min(a[2], b[2]), max(a[3], b[3])


@scalar
def _box_bounds(p: Vector, m: Matrix, size: Vector) -> Rectangle:
    """Bound a box of half-sizes ``size`` by its eight corners."""
    x0, x1, y0, y1 = WIDE, -WIDE, WIDE, -WIDE
    for corner in range(8):
        sx = size[0] if corner & 1 else -size[0]
        sy = size[1] if corner & 2 else -size[1]
        sz = size[2] if corner & 4 else -size[2]
        z = p[2] + m[6] * sx + m[7] * sy + m[8] * sz
        if z > -NEAR:
            return EVERYWHERE
        inverse = ONE / -z
        x = (p[0] + m[0] * sx + m[1] * sy + m[2] * sz) * inverse
        y = (p[1] + m[3] * sx + m[4] * sy + m[5] * sz) * inverse
        x0, x1, y0, y1 = min(x0, x), max(x1, x), min(y0, y), max(y1, y)
    return x0, x1, y0, y1


@scalar
def _bounds(
    kind: np.int32, p: Vector, frame: Matrix, size: Vector, middle: Vector, half: Vector
) -> Rectangle:
    """Bound the projection of a geom of any type."""
    if kind == MESH:
        off = to_parent(frame, middle)
        return _box_bounds((p[0] + off[0], p[1] + off[1], p[2] + off[2]), frame, half)
    radius = size[0]
    if kind == BOX:
        return _box_bounds(p, frame, size)
    if kind == CYLINDER:
        return _long_bounds(p, frame, size[1], (radius, radius, ZERO))
    if kind == CAPSULE:
        return _long_bounds(p, frame, size[1], (radius, radius, radius))
    if kind == SPHERE:
        return _round_bounds(p, frame, (radius, radius, radius))
    if kind == ELLIPSOID:
        return _round_bounds(p, frame, size)
    if (kind == PLANE) & (size[0] > ZERO) & (size[1] > ZERO):
        return _box_bounds(p, frame, (size[0], size[1], ZERO))
    return EVERYWHERE


@scalar
def project_geom(
    kind: np.int32,
    size: Vector,
    middle: Vector,
    half: Vector,
    position: Vector,
    matrix: Matrix,
    eye: Vector,
    camera: Matrix,
    grid: TileGrid,
) -> tuple[bool, tuple[int, int, int, int], Vector, Matrix]:
    """Transform a geom to the camera frame and find the samples that can show it.

    ``middle`` and ``half`` are a mesh's bounding box in its frame [m], ``position`` and ``eye``
    world positions [m]; matrices are from geom and from camera to world. Return whether any of
    the geom can be in the image; first and last column and first and last row of samples; the eye
    in the geom's frame [m]; the rotation from geom to camera.
    """
    p = to_local(camera, minus(position, eye))
    c0 = to_local(camera, (matrix[0], matrix[3], matrix[6]))
    c1 = to_local(camera, (matrix[1], matrix[4], matrix[7]))
    c2 = to_local(camera, (matrix[2], matrix[5], matrix[8]))
    frame = (c0[0], c1[0], c2[0], c0[1], c1[1], c2[1], c0[2], c1[2], c2[2])
    x0, x1, y0, y1 = _bounds(kind, p, frame, size, middle, half)
    first = max(first_sample(x0 - grid.left, grid.pixel, grid.reach), 0)
    last = min(last_sample(x1 - grid.left, grid.pixel, grid.reach), grid.strips * TILE - 1)
    upper = max(first_sample(grid.top - y1, grid.step, ZERO), 0)
    lower = min(last_sample(grid.top - y0, grid.step, ZERO), grid.rows - 1)
    visible = (first <= last) & (upper <= lower)
    return visible, (first, last, upper, lower), to_local(frame, (-p[0], -p[1], -p[2])), frame
