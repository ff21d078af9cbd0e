"""Geom ids and depths that were drawn go in; distances and normals of the pixels come out too."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from knowarm.world.render.cast import meet_geom
from knowarm.world.render.fill import Field
from knowarm.world.render.grid import BITS, TILE, Grid, sample_point
from knowarm.world.render.meshes import Meshes
from knowarm.world.render.numeric import (
    FAR,
    ONE,
    TINY,
    ZERO,
    Vector,
    dot,
    entry,
    minus,
    to_local,
    to_parent,
)
from knowarm.world.render.prepare import nine, triple
from knowarm.world.render.render import Scenery
from knowarm.world.render.tables import MESH
from knowarm.world.render.triangle import face_planes, meet_triangle


@njit(error_model="numpy")
def mesh_normal(meshes: Meshes, geom: int, origin: Vector, direction: Vector) -> Vector:
    """Unit normal of the triangle that a ray meets first, in the geom's frame."""
    best, result = FAR, (ZERO, ZERO, ZERO)
    for f in range(meshes.span[geom, 2], meshes.span[geom, 3]):
        a, b, c = meshes.face[f, 0], meshes.face[f, 1], meshes.face[f, 2]
        planes = face_planes(
            minus(triple(meshes.vertex[a], 0), origin),
            minus(triple(meshes.vertex[b], 0), origin),
            minus(triple(meshes.vertex[c], 0), origin),
        )
        t, _ = meet_triangle(direction, planes)
        if t < best:
            best, result = t, planes[3]
    scale = ONE / math.sqrt(max(dot(result, result), TINY * TINY))
    return result[0] * scale, result[1] * scale, result[2] * scale


@entry
def trace_field(
    field: Field,
    position: NDArray[np.float32],
    matrix: NDArray[np.float32],
    view: NDArray[np.float32],
    scenery: Scenery,
    grid: Grid,
    geom: NDArray[np.int32],
    distance: NDArray[np.float32],
    normal: NDArray[np.float32],
) -> None:
    """Write what one environment's samples show, one sample a pixel.

    Args:
        field: depths and geom ids, as drawn.
        position: (G, 3) world positions.
        matrix: (G, 9) rotations from geom to world.
        view: (12,) camera.
        scenery: what all environments share.
        grid: the samples.
        geom: (H, W) to write ids into, -1 for none.
        distance: (H, W) to write distances [m] into, -1 for none.
        normal: (H, W, 3) to write world normals into, 0 for none.
    """
    camera = nine(view, 3)
    for j in range(geom.shape[0]):
        for i in range(geom.shape[1]):
            place = ((i >> BITS) * grid.rows + j) * TILE + (i & (TILE - 1))
            g = field[1][place]
            geom[j, i] = g
            distance[j, i] = -1
            normal[j, i] = 0
            if g < 0:
                continue
            x, y = sample_point(np.int32(i), np.int32(j), grid)
            ray = (x, y, -ONE)
            distance[j, i] = field[0][place] * math.sqrt(dot(ray, ray))
            p, m = triple(position[g], 0), nine(matrix[g], 0)
            origin = to_local(m, (view[0] - p[0], view[1] - p[1], view[2] - p[2]))
            direction = to_local(m, to_parent(camera, ray))
            if scenery.kind[g] == MESH:
                n = to_parent(m, mesh_normal(scenery.meshes, g, origin, direction))
            else:
                size = triple(scenery.size[g], 0)
                n = to_parent(m, meet_geom(scenery.kind[g], origin, direction, size)[1])
            normal[j, i, 0], normal[j, i, 1], normal[j, i, 2] = n
