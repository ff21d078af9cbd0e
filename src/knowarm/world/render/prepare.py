"""A geom's pose, shape and colour go in; one record of what its pixels need comes out.

A record is a row of ``RECORD`` float32 numbers and a row of ``EXTENT`` int32 numbers:

    record  origin 3 | frame 9 | size 3 | towards sun 3 | paint 9
    extent  kind | geom | first and last column | first and last row of samples

``origin`` is the eye in the geom's frame, ``frame`` the row-major rotation from geom to camera, and
the direction towards the sun is in the geom's frame. The headlight shines along the view, so the
direction towards it is camera z, the last row of ``frame``.
"""

import math

import numpy as np
from numpy.typing import NDArray

from knowarm.world.render import bounds
from knowarm.world.render.grid import TILE, Grid
from knowarm.world.render.numeric import (
    FAR,
    ZERO,
    Matrix,
    Vector,
    minus,
    scalar,
    to_local,
    to_parent,
)
from knowarm.world.render.shading import Paint, paint
from knowarm.world.render.tables import BOX, CAPSULE, CYLINDER, ELLIPSOID, MESH, PLANE, SPHERE

RECORD, EXTENT = 27, 6
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
    return triple(record, 18), triple(record, 21), triple(record, 24)


@scalar
def _floor(value: np.float32) -> np.int32:
    """Round down, where an integer can hold it."""
    return np.int32(math.floor(min(max(value, -FAR), FAR)))


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


@scalar
def prepare(
    kind: np.int32,
    size: Vector,
    middle: Vector,
    half: Vector,
    position: Vector,
    matrix: Matrix,
    eye: Vector,
    camera: Matrix,
    grid: Grid,
) -> tuple[bool, tuple[int, int, int, int], Vector, Matrix]:
    """Place a geom before the camera.

    Args:
        kind: MuJoCo's geom type.
        size: ``geom_size``.
        middle: of a mesh, middle of its bounding box in the geom's frame [m].
        half: half-sizes of that box [m].
        position: position in the world [m].
        matrix: row-major rotation from geom to world.
        eye: position of the camera in the world [m].
        camera: row-major rotation from camera to world.
        grid: the samples.

    Returns:
        Whether any of the geom can lie in the image, the columns and rows of samples (first and
        last each), ``origin`` and ``frame``.
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


@scalar
def prepare_light(
    rgb: Vector, glow: np.float32, lamps: tuple[Vector, Vector, Vector, Vector], matrix: Matrix
) -> tuple[Vector, Paint]:
    """Direction towards the sun in the geom's frame, and the geom's paint; see ``Tables.lamps``."""
    return to_local(matrix, lamps[3]), paint(rgb, glow, (lamps[0], lamps[1], lamps[2]))
