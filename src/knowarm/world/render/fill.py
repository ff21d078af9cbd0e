"""A geom's record goes in; depth and value of the samples it wins come out.

The tiles of a geom that lie in one strip are one run of memory. One branch-free loop draws the run,
which the compiler turns into vector code of sixteen samples, a tile.
"""

from collections.abc import Callable

import numpy as np
from numba import njit
from numpy.typing import NDArray

from knowarm.world.render import geometry
from knowarm.world.render.cast import sample_direction
from knowarm.world.render.grid import BITS, TILE, Grid, sample_point
from knowarm.world.render.numeric import Vector
from knowarm.world.render.prepare import nine, record_paint, triple
from knowarm.world.render.shading import shade
from knowarm.world.render.tables import BOX, CAPSULE, CYLINDER, ELLIPSOID, PLANE, SPHERE

Field = tuple[NDArray[np.float32], NDArray[np.int32]]
"""Depth [m] and value (packed colour or geom id) of the samples, (strips * rows * TILE,) each."""


@njit(error_model="numpy")
def _fill(
    meet: Callable[[Vector, Vector, Vector], tuple[np.float32, Vector]],
    record: NDArray[np.float32],
    extent: NDArray[np.int32],
    grid: Grid,
    field: Field,
    ids: bool,
) -> None:
    """Draw a geom whose intersection function is ``meet``; write its id if ``ids``."""
    origin, frame, size = triple(record, 0), nine(record, 3), triple(record, 12)
    head, sun, colours = triple(record, 9), triple(record, 15), record_paint(record)
    geom = extent[1]
    upper = extent[4] >> BITS << BITS
    rows = (extent[5] >> BITS << BITS) + TILE - upper
    for strip in range(extent[2] >> BITS, (extent[3] >> BITS) + 1):
        start = (strip * grid.rows + upper) * TILE
        depth = field[0][start : start + rows * TILE]
        value = field[1][start : start + rows * TILE]
        left, top = np.int32(strip * TILE), np.int32(upper)
        for k in range(rows * TILE):
            lane = np.int32(k)
            column = np.int32(left + (lane & np.int32(TILE - 1)))
            x, y = sample_point(column, np.int32(top + (lane >> np.int32(BITS))), grid)
            direction = sample_direction(x, y, frame)
            t, normal = meet(origin, direction, size)
            colour = shade(normal, head, sun, colours)
            farther, other = depth[k], value[k]
            closer = t < farther
            new = geom if ids else colour
            depth[k] = t if closer else farther
            value[k] = new if closer else other


@njit(error_model="numpy")
def fill(
    record: NDArray[np.float32], extent: NDArray[np.int32], grid: Grid, field: Field, ids: bool
) -> None:
    """Draw a prepared geom of any primitive type."""
    kind = extent[0]
    if kind == BOX:
        _fill(geometry.box, record, extent, grid, field, ids)
    elif kind == CYLINDER:
        _fill(geometry.cylinder, record, extent, grid, field, ids)
    elif kind == CAPSULE:
        _fill(geometry.capsule, record, extent, grid, field, ids)
    elif kind == SPHERE:
        _fill(geometry.sphere, record, extent, grid, field, ids)
    elif kind == ELLIPSOID:
        _fill(geometry.ellipsoid, record, extent, grid, field, ids)
    elif kind == PLANE:
        _fill(geometry.plane, record, extent, grid, field, ids)
