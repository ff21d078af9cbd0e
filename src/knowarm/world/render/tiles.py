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

from numpy import float32, int32

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
    dot,
    minus,
    plus,
    product,
    scalar,
    times,
    to_local,
    to_parent,
    transposed,
)

BITS = 2
TILE = 1 << BITS  # Side of a tile of samples
ANTIALIASING = 4  # Samples per pixel with anti-aliasing
SLACK = float32(0.02)
"""Fraction of a pixel or row by which a rectangle is widened against rounding."""

RECORD = 27  # Float numbers stored per projected geom
EXTENT = 6  # Integers stored per projected geom
# Points closer to the eye than this have no useful projection [m]
NEAR = float32(1e-3)
Rectangle = tuple[float32, float32, float32, float32]
# First and last column, first and last row of samples
Window = tuple[int, int, int, int]

WIDE = float32(1e6)
EVERYWHERE = (-WIDE, WIDE, -WIDE, WIDE)
NOWHERE = (WIDE, -WIDE, WIDE, -WIDE)


class TileGrid(NamedTuple):
    """Positions of the samples in image coordinates."""

    left: float32  # X of the centre of the first pixel
    top: float32  # Y of the first row
    pixel: float32  # Width of a pixel
    step: float32  # Distance between rows, ``pixel / S``
    mask: int32  # S - 1; row & mask is the index of the sample within its pixel
    shift: float32  # Horizontal offset of sample 0 from the centre of the pixel
    advance: float32  # Horizontal distance from one sample to the next
    # Horizontal distance back before sample 2, so that sample 3 stays inside the pixel
    back: float32
    reach: float32  # Largest horizontal distance of a sample from the centre, in pixels
    strips: int32  # Number of strips of ``TILE`` columns that hold the image
    rows: int32  # Number of rows of samples, a multiple of ``TILE``


SIDEWAYS = {1: (0, 0, 0, 0), ANTIALIASING: (-0.5, 2, 5, 1.5)}
"""Shift, advance, back and reach of a `TileGrid` in quarters of a pixel, by samples per pixel.

Sample s of four lies at 2 s - .5, less 5 from sample 2 on.
"""


def make_grid(width: int, height: int, half_height: float, samples: int) -> TileGrid:
    """Lay out 1 or ``ANTIALIASING`` samples per pixel; ``half_height`` is tan(fovy / 2)."""
    pixel = 2 * half_height / height
    step = pixel / samples
    quarter = pixel / 4
    shift, advance, back, reach = SIDEWAYS[samples]
    return TileGrid(
        left=float32((1 - width) / 2 * pixel),
        top=float32(half_height - step / 2),
        pixel=float32(pixel),
        step=float32(step),
        mask=int32(samples - 1),
        shift=float32(shift * quarter),
        advance=float32(advance * quarter),
        back=float32(back * quarter),
        reach=float32(reach / 4),
        strips=int32(-(-width // TILE)),
        rows=int32(-(-height * samples // TILE) * TILE),
    )


@scalar
def sample_point(column: int32, row: int32, grid: TileGrid) -> tuple[float32, float32]:
    """Return X and Y of the sample in a pixel column and a row of samples."""
    s = int32(row & grid.mask)
    half = int32(s >> int32(1))
    aside = grid.shift + float32(s) * grid.advance - float32(half) * grid.back
    x = grid.left + float32(column) * grid.pixel + aside
    return x, grid.top - float32(row) * grid.step


@scalar
def sample_direction(
    column: int32, row: int32, frame: Matrix, grid: TileGrid
) -> Vector:
    """Return the direction of the ray through a sample, in a geom's frame."""
    x, y = sample_point(column, row, grid)
    return to_local(frame, (x, y, -ONE))


@scalar
def _floor(value: float32) -> int32:
    """Round down, clamped to what an integer can hold."""
    return int32(math.floor(min(max(value, -FAR), FAR)))


@scalar
def _first_sample(distance: float32, step: float32, reach: float32) -> int:
    """Return the index of the first sample beyond a distance from sample 0, less ``SLACK``."""
    return _floor(distance / step - SLACK - reach) + 1


@scalar
def _last_sample(distance: float32, step: float32, reach: float32) -> int:
    """Return the index of the last sample within a distance from sample 0, plus ``SLACK``."""
    return _floor(distance / step + SLACK + reach)


@scalar
def samples_within(bounds: Rectangle, limits: Window, grid: TileGrid) -> Window:
    """Return the window of the samples within a rectangle and within a window."""
    x0, x1, y0, y1 = bounds
    left, right, upper, lower = limits
    return (
        max(left, _first_sample(x0 - grid.left, grid.pixel, grid.reach)),
        min(right, _last_sample(x1 - grid.left, grid.pixel, grid.reach)),
        max(upper, _first_sample(grid.top - y1, grid.step, ZERO)),
        min(lower, _last_sample(grid.top - y0, grid.step, ZERO)),
    )


@scalar
def is_empty(window: Window) -> bool:
    """Tell whether a window holds no samples."""
    left, right, upper, lower = window
    return (left > right) | (upper > lower)


@scalar
def tiles_of(window: Window) -> Window:
    """Return first strip, one past the last strip, first row and one past the last row of tiles."""
    left, right, upper, lower = window
    return (
        left >> BITS,
        (right >> BITS) + 1,
        upper >> BITS << BITS,
        (lower >> BITS << BITS) + TILE,
    )


@scalar
def _interval(
    p: float32, pz: float32, a_xx: float32, a_xz: float32, a_zz: float32
) -> tuple[float32, float32]:
    """Bound x / -z over {p + M u}, all of it in front of the eye."""
    a = pz * pz - a_zz
    b = p * pz - a_xz
    root = math.sqrt(max(b * b - a * (p * p - a_xx), ZERO))
    inverse = ONE / a
    return (-b - root) * inverse, (-b + root) * inverse


@scalar
def _round_bounds(p: Vector, m: Matrix, axes: Vector) -> Rectangle:
    """Bound an ellipsoid of half-axes ``axes`` (0 for a disc) at p with rotation m."""
    px, py, pz = p
    mx, my, mz = m
    squares = product(axes, axes)
    a_zz = dot(product(mz, mz), squares)
    if pz + math.sqrt(a_zz) > -NEAR:
        return EVERYWHERE
    a_xx = dot(product(mx, mx), squares)
    a_yy = dot(product(my, my), squares)
    a_xz = dot(product(mx, mz), squares)
    a_yz = dot(product(my, mz), squares)
    x0, x1 = _interval(px, pz, a_xx, a_xz, a_zz)
    y0, y1 = _interval(py, pz, a_yy, a_yz, a_zz)
    return x0, x1, y0, y1


@scalar
def _union(a: Rectangle, b: Rectangle) -> Rectangle:
    """Bound two rectangles."""
    ax0, ax1, ay0, ay1 = a
    bx0, bx1, by0, by1 = b
    return min(ax0, bx0), max(ax1, bx1), min(ay0, by0), max(ay1, by1)


@scalar
def _long_bounds(p: Vector, m: Matrix, half: float32, end: Vector) -> Rectangle:
    """Bound the convex hull of two equal round ends at +-half along the local z axis."""
    _, _, z_axis = transposed(m)
    to_end = times(z_axis, half)
    return _union(
        _round_bounds(plus(p, to_end), m, end), _round_bounds(minus(p, to_end), m, end)
    )


@scalar
def _box_bounds(p: Vector, m: Matrix, size: Vector) -> Rectangle:
    """Bound a box of half-sizes ``size`` by its eight corners."""
    x_axis, y_axis, z_axis = transposed(m)
    half_x, half_y, half_z = size
    bounds = NOWHERE
    for along_x in (-half_x, half_x):
        face = plus(p, times(x_axis, along_x))
        for along_y in (-half_y, half_y):
            edge = plus(face, times(y_axis, along_y))
            for along_z in (-half_z, half_z):
                x, y, z = plus(edge, times(z_axis, along_z))
                if z > -NEAR:
                    return EVERYWHERE
                inverse = ONE / -z
                x *= inverse
                y *= inverse
                bounds = _union(bounds, (x, x, y, y))
    return bounds


@scalar
def _bounds(
    kind: int32, p: Vector, frame: Matrix, size: Vector, middle: Vector, half: Vector
) -> Rectangle:
    """Bound the projection of a geom of any type."""
    if kind == MESH:
        return _box_bounds(plus(p, to_parent(frame, middle)), frame, half)
    if kind == BOX:
        return _box_bounds(p, frame, size)
    radius, half_length, _ = size
    if kind == CYLINDER:
        return _long_bounds(p, frame, half_length, (radius, radius, ZERO))
    if kind == CAPSULE:
        return _long_bounds(p, frame, half_length, (radius, radius, radius))
    if kind == SPHERE:
        return _round_bounds(p, frame, (radius, radius, radius))
    if kind == ELLIPSOID:
        return _round_bounds(p, frame, size)
    half_x, half_y, _ = size
    if (kind == PLANE) & (half_x > ZERO) & (half_y > ZERO):
        return _box_bounds(p, frame, (half_x, half_y, ZERO))
    return EVERYWHERE


@scalar
def project_geom(
    kind: int32,
    size: Vector,
    middle: Vector,
    half: Vector,
    position: Vector,
    matrix: Matrix,
    eye: Vector,
    camera: Matrix,
    grid: TileGrid,
) -> tuple[Window, Vector, Matrix]:
    """Transform a geom to the camera frame and find the samples that can show it.

    ``middle`` and ``half`` are a mesh's bounding box in its frame [m], ``position`` and ``eye``
    world positions [m]; matrices are from geom and from camera to world. Return first and last
    column and first and last row of samples; the eye in the geom's frame [m]; the rotation from
    geom to camera.
    """
    p = to_local(camera, minus(position, eye))
    x_axis, y_axis, z_axis = transposed(matrix)
    axes = (
        to_local(camera, x_axis),
        to_local(camera, y_axis),
        to_local(camera, z_axis),
    )
    frame = transposed(axes)
    bounds = _bounds(kind, p, frame, size, middle, half)
    image = (0, grid.strips * TILE - 1, 0, grid.rows - 1)
    return samples_within(bounds, image, grid), to_local(frame, times(p, -ONE)), frame
