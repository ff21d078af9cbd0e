"""A geom's pose, shape and colour go in; one record of what its pixels need comes out.

A record is a row of ``RECORD`` float32 numbers and a row of ``EXTENT`` int32 numbers:

    record  origin 3 | frame 9 | size 3 | towards headlight 3 | towards sun 3 | paint 9
    extent  kind | geom | first and last column | first and last row of samples

``origin`` is the eye in the geom's frame, ``frame`` the row-major rotation from geom to camera;
both directions to the lights are in the geom's frame.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from knowarm.world.raycast import bounds
from knowarm.world.raycast.grid import TILE, Grid
from knowarm.world.raycast.numeric import FAR, ZERO, Matrix, Vector, scalar, to_local, to_parent
from knowarm.world.raycast.shading import Paint, paint
from knowarm.world.raycast.tables import BOX, CAPSULE, CYLINDER, ELLIPSOID, MESH, PLANE, SPHERE

RECORD, EXTENT = 30, 6
SLACK = np.float32(0.02)
"""Part of a pixel or row by which a rectangle is widened, against rounding."""


@scalar
def triple(values: NDArray[np.float32], start: int) -> Vector:
    """Three numbers from a place on."""
    return values[start], values[start + 1], values[start + 2]


@scalar
def nine(values: NDArray[np.float32], start: int) -> Matrix:
    """Nine numbers from a place on."""
    return (
        values[start], values[start + 1], values[start + 2],
        values[start + 3], values[start + 4], values[start + 5],
        values[start + 6], values[start + 7], values[start + 8],
    )  # fmt: skip


@scalar
def record_paint(record: NDArray[np.float32]) -> Paint:
    """The paint in a record."""
    return triple(record, 21), triple(record, 24), triple(record, 27)


@scalar
def _floor(value: np.float32) -> int:
    """Round down, where an integer can hold it."""
    return math.floor(min(max(value, -FAR), FAR))


@scalar
def first_sample(way: np.float32, step: np.float32, reach: np.float32) -> int:
    """Number of the first sample beyond a way from sample 0, with room for shift and rounding."""
    return _floor(way / step - SLACK - reach) + 1


@scalar
def last_sample(way: np.float32, step: np.float32, reach: np.float32) -> int:
    """Number of the last sample within a way from sample 0, with room for shift and rounding."""
    return _floor(way / step + SLACK + reach)


@scalar
def _bounds(
    kind: np.int32, p: Vector, frame: Matrix, size: Vector, middle: Vector, half: Vector
) -> bounds.Rectangle:
    if kind == MESH:
        off = to_parent(frame, middle)
        return bounds.box_bounds((p[0] + off[0], p[1] + off[1], p[2] + off[2]), frame, half)
    radius = size[0]
    if kind == BOX:
        return bounds.box_bounds(p, frame, size)
    if kind == CYLINDER:
        return bounds.long_bounds(p, frame, size[1], (radius, radius, ZERO))
    if kind == CAPSULE:
        return bounds.long_bounds(p, frame, size[1], (radius, radius, radius))
    if kind == SPHERE:
        return bounds.round_bounds(p, frame, (radius, radius, radius))
    if kind == ELLIPSOID:
        return bounds.round_bounds(p, frame, size)
    if (kind == PLANE) & (size[0] > ZERO) & (size[1] > ZERO):
        return bounds.box_bounds(p, frame, (size[0], size[1], ZERO))
    return bounds.EVERYWHERE


@njit(error_model="numpy")
def prepare(
    kind: np.int32,
    geom: np.int32,
    size: Vector,
    middle: Vector,
    half: Vector,
    position: Vector,
    matrix: Matrix,
    view: NDArray[np.float32],
    rgb: Vector,
    glow: np.float32,
    lamps: NDArray[np.float32],
    grid: Grid,
    record: NDArray[np.float32],
    extent: NDArray[np.int32],
) -> bool:
    """Write a geom's record and extent.

    Args:
        kind: MuJoCo's geom type.
        geom: id of the geom.
        size: ``geom_size``.
        middle: of a mesh, middle of its bounding box in the geom's frame [m].
        half: half-sizes of that box [m].
        position: position in the world [m].
        matrix: row-major rotation from geom to world.
        view: (12,) position and row-major rotation of the camera in the world.
        rgb: the geom's colour.
        glow: emission of the geom's material.
        lamps: (12,) rows of ``Tables.lamps``.
        grid: the samples.
        record: (RECORD,) to write into.
        extent: (EXTENT,) to write into.

    Returns:
        Whether any of the geom can lie in the picture.
    """
    camera = nine(view, 3)
    p = to_local(camera, (position[0] - view[0], position[1] - view[1], position[2] - view[2]))
    c0 = to_local(camera, (matrix[0], matrix[3], matrix[6]))
    c1 = to_local(camera, (matrix[1], matrix[4], matrix[7]))
    c2 = to_local(camera, (matrix[2], matrix[5], matrix[8]))
    frame = (c0[0], c1[0], c2[0], c0[1], c1[1], c2[1], c0[2], c1[2], c2[2])
    x0, x1, y0, y1 = _bounds(kind, p, frame, size, middle, half)
    first = max(first_sample(x0 - grid.left, grid.pixel, grid.reach), 0)
    last = min(last_sample(x1 - grid.left, grid.pixel, grid.reach), grid.strips * TILE - 1)
    upper = max(first_sample(grid.top - y1, grid.step, ZERO), 0)
    lower = min(last_sample(grid.top - y0, grid.step, ZERO), grid.rows - 1)
    if (first > last) | (upper > lower):
        return False
    extent[0], extent[1] = kind, geom
    extent[2], extent[3], extent[4], extent[5] = first, last, upper, lower
    record[0], record[1], record[2] = to_local(frame, (-p[0], -p[1], -p[2]))
    for i in range(9):
        record[3 + i] = frame[i]
    record[12], record[13], record[14] = size
    # The headlight shines along the view: towards it is camera z.
    record[15], record[16], record[17] = frame[6], frame[7], frame[8]
    record[18], record[19], record[20] = to_local(matrix, triple(lamps, 9))
    dark, head, sun = paint(rgb, glow, (triple(lamps, 0), triple(lamps, 3), triple(lamps, 6)))
    record[21], record[22], record[23] = dark
    record[24], record[25], record[26] = head
    record[27], record[28], record[29] = sun
    return True
