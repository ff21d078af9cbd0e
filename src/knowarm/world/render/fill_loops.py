"""Fill loops of the CPU ray caster: depth and colour of the samples that a geom covers.

The tiles of a geom in one strip are contiguous in memory: one branch-free loop draws them, which
the compiler vectorizes over the sixteen samples of a tile. Triangles of a mesh are drawn one after
the other by such a loop that only notes which triangle is nearest; the samples that show the mesh
are shaded once at the end. In small images most triangles of a fine mesh lie between the samples
and are skipped.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from knowarm.world.render import intersections
from knowarm.world.render.intersections import (
    BOX,
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    PLANE,
    SPHERE,
    Hit,
    face_planes,
    triangle,
)
from knowarm.world.render.numeric import (
    ONE,
    ZERO,
    Matrix,
    Vector,
    minus,
    nine,
    scalar,
    shade,
    to_parent,
    triple,
)
from knowarm.world.render.scenery import Meshes
from knowarm.world.render.tiles import (
    BITS,
    NEAR,
    TILE,
    TileGrid,
    first_sample,
    last_sample,
    sample_direction,
    sample_point,
)

Field = tuple[NDArray[np.float32], NDArray[np.int32]]
"""Depth [m] and value (packed colour or geom id) of the samples, (strips * rows * TILE,) each."""

PROJECTION = 3  # Numbers stored per vertex: X, Y, and 1 if it is behind the eye, else -1


@njit(error_model="numpy")
def _fill(
    hit: Callable[..., Hit],
    first: tuple[Any, ...],
    last: tuple[Any, ...],
    window: tuple[int, int, int, int],
    record: NDArray[np.float32],
    geom: np.int32,
    grid: TileGrid,
    field: Field,
    ids: bool,
) -> None:
    """Draw ``hit(first, direction, last)`` into columns and rows of samples."""
    frame, head, sun = nine(record, 3), triple(record, 9), triple(record, 15)
    paint = triple(record, 18), triple(record, 21), triple(record, 24)
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
            t, normal = hit(first, sample_direction(x, y, frame), last)
            colour = shade(normal, head, sun, paint)
            farther, other = depth[k], value[k]
            closer = t < farther
            new = geom if ids else colour
            depth[k] = t if closer else farther
            value[k] = new if closer else other


@njit(error_model="numpy")
def _fill_triangle(
    planes: intersections.Faces,
    window: tuple[int, int, int, int],
    frame: Matrix,
    mark: np.int32,
    grid: TileGrid,
    field: Field,
) -> None:
    """Note ``mark`` in the columns and rows of samples where a triangle is nearest."""
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
            t, _ = triangle(planes, sample_direction(x, y, frame))
            farther, other = depth[k], value[k]
            closer = t < farther
            depth[k] = t if closer else farther
            value[k] = mark if closer else other


@njit(error_model="numpy")
def _shade_triangles(
    record: NDArray[np.float32],
    extent: NDArray[np.int32],
    grid: TileGrid,
    meshes: Meshes,
    value: NDArray[np.int32],
) -> None:
    """Replace the triangles' marks in the samples of a mesh by their colours."""
    eye, frame = triple(record, 0), nine(record, 3)
    head, sun = triple(record, 9), triple(record, 15)
    paint = triple(record, 18), triple(record, 21), triple(record, 24)
    upper, lower = extent[4] >> BITS << BITS, (extent[5] >> BITS << BITS) + TILE
    for strip in range(extent[2] >> BITS, (extent[3] >> BITS) + 1):
        for row in range(upper, lower):
            start = (strip * grid.rows + row) * TILE
            for lane in range(TILE):
                mark = value[start + lane]
                if mark >= 0:
                    continue
                f = -1 - mark
                a, b, c = corners(meshes, f, eye)
                x, y = sample_point(np.int32(strip * TILE + lane), np.int32(row), grid)
                _, normal = intersections.smooth_triangle(
                    face_planes(a, b, c),
                    sample_direction(x, y, frame),
                    (
                        triple(meshes.normal[f], 0),
                        triple(meshes.normal[f], 3),
                        triple(meshes.normal[f], 6),
                    ),
                )
                value[start + lane] = shade(normal, head, sun, paint)


@njit(error_model="numpy")
def fill_primitive(
    record: NDArray[np.float32], extent: NDArray[np.int32], grid: TileGrid, field: Field, ids: bool
) -> None:
    """Draw a projected primitive."""
    kind, geom = extent[0], extent[1]
    origin, size = triple(record, 0), triple(record, 12)
    window = (extent[2], extent[3], extent[4], extent[5])
    if kind == BOX:
        _fill(intersections.box, origin, size, window, record, geom, grid, field, ids)
    elif kind == CYLINDER:
        _fill(intersections.cylinder, origin, size, window, record, geom, grid, field, ids)
    elif kind == CAPSULE:
        _fill(intersections.capsule, origin, size, window, record, geom, grid, field, ids)
    elif kind == SPHERE:
        _fill(intersections.sphere, origin, size, window, record, geom, grid, field, ids)
    elif kind == ELLIPSOID:
        _fill(intersections.ellipsoid, origin, size, window, record, geom, grid, field, ids)
    elif kind == PLANE:
        _fill(intersections.plane, origin, size, window, record, geom, grid, field, ids)


@scalar
def corners(meshes: Meshes, face: int, origin: Vector) -> tuple[Vector, Vector, Vector]:
    """Corners of a triangle relative to an origin in the geom's frame [m]."""
    return (
        minus(triple(meshes.vertex[meshes.face[face, 0]], 0), origin),
        minus(triple(meshes.vertex[meshes.face[face, 1]], 0), origin),
        minus(triple(meshes.vertex[meshes.face[face, 2]], 0), origin),
    )


@njit(error_model="numpy")
def fill_mesh(
    record: NDArray[np.float32],
    extent: NDArray[np.int32],
    grid: TileGrid,
    meshes: Meshes,
    projection: NDArray[np.float32],
    field: Field,
    ids: bool,
) -> None:
    """Draw a projected mesh; ``projection`` is working memory (see ``Scratch``)."""
    geom = extent[1]
    span = meshes.span[geom]
    eye, frame = triple(record, 0), nine(record, 3)
    first = span[0]
    # Seen from outside, the far side of a closed mesh is hidden by its near side.
    away = minus(eye, triple(meshes.middle[geom], 0))
    half = triple(meshes.half[geom], 0)
    outside = (abs(away[0]) > half[0]) | (abs(away[1]) > half[1]) | (abs(away[2]) > half[2])
    winding = np.float32(meshes.winding[geom]) if outside else ZERO
    for i in range(span[1] - first):
        p = to_parent(frame, minus(triple(meshes.vertex[first + i], 0), eye))
        behind = p[2] > -NEAR
        inverse = -ONE / (-ONE if behind else p[2])
        projection[0, i] = p[0] * inverse
        projection[1, i] = p[1] * inverse
        projection[2, i] = ONE if behind else -ONE
    for f in range(span[2], span[3]):
        i, j, k = meshes.face[f, 0] - first, meshes.face[f, 1] - first, meshes.face[f, 2] - first
        left, right, upper, lower = extent[2], extent[3], extent[4], extent[5]
        if max(projection[2, i], projection[2, j], projection[2, k]) < 0:
            x, y = projection[0], projection[1]
            turn = (x[j] - x[i]) * (y[k] - y[i]) - (x[k] - x[i]) * (y[j] - y[i])
            if turn * winding < ZERO:
                continue
            x0, x1 = min(x[i], x[j], x[k]) - grid.left, max(x[i], x[j], x[k]) - grid.left
            y0, y1 = grid.top - max(y[i], y[j], y[k]), grid.top - min(y[i], y[j], y[k])
            left = max(left, first_sample(x0, grid.pixel, grid.reach))
            right = min(right, last_sample(x1, grid.pixel, grid.reach))
            upper = max(upper, first_sample(y0, grid.step, ZERO))
            lower = min(lower, last_sample(y1, grid.step, ZERO))
        if (left > right) | (upper > lower):
            continue
        a, b, c = corners(meshes, f, eye)
        mark = np.int32(geom if ids else -1 - f)
        window = (left, right, upper, lower)
        _fill_triangle(face_planes(a, b, c), window, frame, mark, grid, field)
    if not ids:
        _shade_triangles(record, extent, grid, meshes, field[1])
