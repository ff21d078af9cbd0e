"""A mesh geom's record goes in; depth and value of the samples its triangles win come out.

Each triangle is drawn into the tiles around its projection. In small images most triangles of a
fine mesh lie between the samples and are dropped after their corners' projection.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from knowarm.world.render.bounds import NEAR
from knowarm.world.render.cast import sample_direction
from knowarm.world.render.fill import Field
from knowarm.world.render.grid import BITS, TILE, Grid, sample_point
from knowarm.world.render.meshes import Meshes
from knowarm.world.render.numeric import ONE, ZERO, Vector, minus, to_parent
from knowarm.world.render.prepare import (
    first_sample,
    last_sample,
    nine,
    record_paint,
    triple,
)
from knowarm.world.render.shading import shade
from knowarm.world.render.triangle import blend, face_planes, meet_triangle

PROJECTION = 3
"""Numbers kept a vertex: X, Y and whether it is behind the eye."""


@njit(error_model="numpy")
def _fill_triangle(
    corners: tuple[Vector, Vector, Vector],
    normals: tuple[Vector, Vector, Vector],
    window: tuple[int, int, int, int],
    record: NDArray[np.float32],
    geom: np.int32,
    grid: Grid,
    field: Field,
    ids: bool,
) -> None:
    """Draw a triangle, its corners seen from the eye, into columns and rows of samples."""
    planes = face_planes(corners[0], corners[1], corners[2])
    frame, head, sun = nine(record, 3), triple(record, 9), triple(record, 15)
    colours = record_paint(record)
    upper = window[2] >> BITS << BITS
    rows = (window[3] >> BITS << BITS) + TILE - upper
    for strip in range(window[0] >> BITS, (window[1] >> BITS) + 1):
        start = (strip * grid.rows + upper) * TILE
        depth = field[0][start : start + rows * TILE]
        value = field[1][start : start + rows * TILE]
        left, top = np.int32(strip * TILE), np.int32(upper)
        for k in range(rows * TILE):
            lane = np.int32(k)
            column = np.int32(left + (lane & np.int32(TILE - 1)))
            x, y = sample_point(column, np.int32(top + (lane >> np.int32(BITS))), grid)
            direction = sample_direction(x, y, frame)
            t, weights = meet_triangle(direction, planes)
            normal = blend(weights, normals[0], normals[1], normals[2])
            colour = shade(normal, head, sun, colours)
            farther, other = depth[k], value[k]
            closer = t < farther
            new = geom if ids else colour
            depth[k] = t if closer else farther
            value[k] = new if closer else other


@njit(error_model="numpy")
def fill_mesh(
    record: NDArray[np.float32],
    extent: NDArray[np.int32],
    grid: Grid,
    meshes: Meshes,
    projection: NDArray[np.float32],
    field: Field,
    ids: bool,
) -> None:
    """Draw a prepared mesh geom.

    Args:
        record: as ``prepare`` wrote it.
        extent: likewise.
        grid: the samples.
        meshes: the model's triangles.
        projection: (PROJECTION, vertices of the largest mesh) to work in.
        field: what is drawn into.
        ids: write the geom's id instead of colours.
    """
    span = meshes.span[extent[1]]
    eye, frame = triple(record, 0), nine(record, 3)
    first = span[0]
    # Seen from outside, the far side of a closed mesh is hidden by its near side.
    away = minus(eye, triple(meshes.middle[extent[1]], 0))
    half = triple(meshes.half[extent[1]], 0)
    outside = (abs(away[0]) > half[0]) | (abs(away[1]) > half[1]) | (abs(away[2]) > half[2])
    winding = np.float32(meshes.winding[extent[1]]) if outside else ZERO
    for i in range(span[1] - first):
        p = to_parent(frame, minus(triple(meshes.vertex[first + i], 0), eye))
        behind = p[2] > -NEAR
        inverse = -ONE / (-ONE if behind else p[2])
        projection[0, i] = p[0] * inverse
        projection[1, i] = p[1] * inverse
        projection[2, i] = ONE if behind else -ONE
    for f in range(span[2], span[3]):
        a, b, c = meshes.face[f, 0], meshes.face[f, 1], meshes.face[f, 2]
        i, j, k = a - first, b - first, c - first
        left, right, upper, lower = extent[2], extent[3], extent[4], extent[5]
        if max(projection[2, i], projection[2, j], projection[2, k]) < 0:
            x, y = projection[0], projection[1]
            turn = (x[j] - x[i]) * (y[k] - y[i]) - (x[k] - x[i]) * (y[j] - y[i])
            if turn * winding < ZERO:
                continue
            left = max(
                left, first_sample(min(x[i], x[j], x[k]) - grid.left, grid.pixel, grid.reach)
            )
            right = min(
                right, last_sample(max(x[i], x[j], x[k]) - grid.left, grid.pixel, grid.reach)
            )
            upper = max(upper, first_sample(grid.top - max(y[i], y[j], y[k]), grid.step, ZERO))
            lower = min(lower, last_sample(grid.top - min(y[i], y[j], y[k]), grid.step, ZERO))
        if (left > right) | (upper > lower):
            continue
        corners = (
            minus(triple(meshes.vertex[a], 0), eye),
            minus(triple(meshes.vertex[b], 0), eye),
            minus(triple(meshes.vertex[c], 0), eye),
        )
        normals = (
            triple(meshes.normal[f], 0), triple(meshes.normal[f], 3), triple(meshes.normal[f], 6)
        )  # fmt: skip
        window = (left, right, upper, lower)
        _fill_triangle(corners, normals, window, record, extent[1], grid, field, ids)
