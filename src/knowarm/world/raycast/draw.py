"""One geom before the camera goes in; depth, owner and colour of the pixels it wins come out.

The three planes have shape (H, W), W a multiple of ``LANES``. Each row of a geom's rectangle is one
branch-free loop of whole blocks of ``LANES`` pixels, which the compiler turns into vector code.
"""

import math
from collections.abc import Callable

import numpy as np
from numba import njit
from numpy.typing import NDArray

from knowarm.world.raycast import bounds, geometry
from knowarm.world.raycast.numeric import (
    ZERO,
    Grid,
    Matrix,
    Planes,
    Vector,
    scalar,
    to_local,
)
from knowarm.world.raycast.shading import Paint, paint, shade
from knowarm.world.raycast.tables import BOX, CAPSULE, CYLINDER, ELLIPSOID, PLANE, SPHERE

LANES = 16
SLACK = np.float32(0.02)
"""Pixels by which a rectangle is widened, against rounding."""


@scalar
def _floor(value: np.float32, length: int) -> int:
    """Round down to an integer in -1 .. length."""
    return math.floor(min(max(value, np.float32(-1)), np.float32(length)))


@njit(error_model="numpy")
def _fill(
    meet: Callable[[Vector, Vector, Vector], tuple[np.float32, Vector]],
    planes: Planes,
    grid: Grid,
    rectangle: bounds.Rectangle,
    origin: Vector,
    frame: Matrix,
    size: Vector,
    lamps: tuple[Vector, Vector],
    colours: Paint,
    g: np.int32,
) -> None:
    """Draw a geom whose intersection function is ``meet`` into its rectangle.

    Args:
        meet: a function of ``geometry``.
        planes: depth float32, owner int32 and packed colour int32, (H, W) each.
        grid: picture coordinates of the first pixel's centre, and a pixel's size.
        rectangle: picture coordinates between which the geom lies.
        origin: the eye in the geom's frame.
        frame: row-major rotation from geom to camera.
        size: ``geom_size``.
        lamps: towards both lights, in the geom's frame.
        colours: the geom's ``Paint``.
        g: what to write as owner.
    """
    depth, owner, colour = planes
    left, top, pixel = grid
    height, width = depth.shape
    i0 = max(_floor((rectangle[0] - left) / pixel - SLACK, width) + 1, 0)
    i1 = min(_floor((rectangle[1] - left) / pixel + SLACK, width), width - 1)
    j0 = max(_floor((top - rectangle[3]) / pixel - SLACK, height) + 1, 0)
    j1 = min(_floor((top - rectangle[2]) / pixel + SLACK, height), height - 1)
    if i1 < i0:
        return
    start = i0 // LANES * LANES
    stop = (i1 // LANES + 1) * LANES
    for j in range(j0, j1 + 1):
        y = top - np.float32(j) * pixel
        row = (y * frame[3] - frame[6], y * frame[4] - frame[7], y * frame[5] - frame[8])
        depths, owners = depth[j, start:stop], owner[j, start:stop]
        packed = colour[j, start:stop]
        for k in range(stop - start):
            x = left + np.float32(start + k) * pixel
            direction = (x * frame[0] + row[0], x * frame[1] + row[1], x * frame[2] + row[2])
            t, normal = meet(origin, direction, size)
            shown = shade(normal, lamps[0], lamps[1], colours)
            if t < depths[k]:
                depths[k] = t
                owners[k] = g
                packed[k] = shown


@njit(error_model="numpy")
def draw_geom(
    kind: np.int32,
    size: Vector,
    position: Vector,
    matrix: Matrix,
    view: NDArray[np.float32],
    rgb: Vector,
    glow: np.float32,
    lamps: tuple[Vector, Vector, Vector, Vector],
    grid: Grid,
    planes: Planes,
    g: np.int32,
) -> None:
    """Draw one geom of any type.

    Args:
        kind: MuJoCo's geom type.
        size: ``geom_size`` as a tuple.
        position: position in the world, a tuple of 3.
        matrix: row-major rotation from geom to world, a tuple of 9.
        view: (12,) position and row-major rotation of the camera.
        rgb: the geom's colour, a tuple of 3.
        glow: the material's emission.
        lamps: ambient, headlight and sun colours and the direction towards the sun in the world.
        grid: as in ``_fill``.
        planes: as in ``_fill``.
        g: the geom's id.
    """
    eye = (position[0] - view[0], position[1] - view[1], position[2] - view[2])
    camera = (
        view[3], view[4], view[5], view[6], view[7], view[8], view[9], view[10], view[11],
    )  # fmt: skip
    p = to_local(camera, eye)
    c0 = to_local(camera, (matrix[0], matrix[3], matrix[6]))
    c1 = to_local(camera, (matrix[1], matrix[4], matrix[7]))
    c2 = to_local(camera, (matrix[2], matrix[5], matrix[8]))
    frame = (c0[0], c1[0], c2[0], c0[1], c1[1], c2[1], c0[2], c1[2], c2[2])
    origin = to_local(frame, (-p[0], -p[1], -p[2]))
    # The headlight shines along the view, so it is met by looking back along camera z.
    local = ((frame[6], frame[7], frame[8]), to_local(matrix, lamps[3]))
    colours = paint(rgb, glow, (lamps[0], lamps[1], lamps[2]))
    radius = size[0]
    if kind == BOX:
        r = bounds.box_bounds(p, frame, size)
        _fill(geometry.box, planes, grid, r, origin, frame, size, local, colours, g)
    elif kind == CYLINDER:
        r = bounds.long_bounds(p, frame, size[1], (radius, radius, ZERO))
        _fill(geometry.cylinder, planes, grid, r, origin, frame, size, local, colours, g)
    elif kind == CAPSULE:
        r = bounds.long_bounds(p, frame, size[1], (radius, radius, radius))
        _fill(geometry.capsule, planes, grid, r, origin, frame, size, local, colours, g)
    elif kind == SPHERE:
        r = bounds.round_bounds(p, frame, (radius, radius, radius))
        _fill(geometry.sphere, planes, grid, r, origin, frame, size, local, colours, g)
    elif kind == ELLIPSOID:
        r = bounds.round_bounds(p, frame, size)
        _fill(geometry.ellipsoid, planes, grid, r, origin, frame, size, local, colours, g)
    elif kind == PLANE:
        r = bounds.EVERYWHERE
        if (size[0] > ZERO) & (size[1] > ZERO):
            r = bounds.box_bounds(p, frame, (size[0], size[1], ZERO))
        _fill(geometry.plane, planes, grid, r, origin, frame, size, local, colours, g)
