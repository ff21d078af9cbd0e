"""Normals of traced pixels, by the intersections with which the ray caster shades."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from knowarm.world.render.cpu import Raycaster
from knowarm.world.render.fill_loops import corners
from knowarm.world.render.intersections import (
    BOX,
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    MESH,
    SPHERE,
    Hit,
    box,
    capsule,
    cylinder,
    ellipsoid,
    face_planes,
    plane,
    sphere,
    triangle,
)
from knowarm.world.render.numeric import (
    FAR,
    ONE,
    TINY,
    ZERO,
    Vector,
    dot,
    matrix_at,
    scalar,
    times,
    to_local,
    to_parent,
    vector_at,
)
from knowarm.world.render.scenery import Meshes, Scenery
from knowarm.world.render.tiles import TileGrid, sample_point


def pixel_normals(
    caster: Raycaster,
    geom: NDArray[np.int32],
    positions: NDArray[np.float64],
    matrices: NDArray[np.float64],
) -> NDArray[np.float32]:
    """Return the outward unit normal of each pixel's geom (n, H, W), world, 0 for none."""
    normal = np.zeros((*geom.shape, 3), dtype=np.float32)
    poses = positions.astype(np.float32), matrices.astype(np.float32)
    for ids, position, matrix, out in zip(geom, *poses, normal, strict=True):
        _fill(ids, position, matrix, caster.view, caster.scenery, caster.grid, out)
    return normal


@scalar
def _intersect(kind: np.int32, origin: Vector, direction: Vector, size: Vector) -> Hit:
    if kind == BOX:
        return box(origin, direction, size)
    if kind == CYLINDER:
        return cylinder(origin, direction, size)
    if kind == CAPSULE:
        return capsule(origin, direction, size)
    if kind == SPHERE:
        return sphere(origin, direction, size)
    if kind == ELLIPSOID:
        return ellipsoid(origin, direction, size)
    return plane(origin, direction, size)


@njit(error_model="numpy")
def _mesh_normal(
    meshes: Meshes, geom: int, origin: Vector, direction: Vector
) -> Vector:
    """Return the unit normal of the triangle that a ray hits first, in the geom's frame."""
    best, result = FAR, (ZERO, ZERO, ZERO)
    for f in range(meshes.span[geom, 2], meshes.span[geom, 3]):
        a, b, c = corners(meshes, f, origin)
        planes = face_planes(a, b, c)
        t, _ = triangle(planes, direction)
        if t < best:
            best, result = t, planes[3]
    return times(result, ONE / math.sqrt(max(dot(result, result), TINY * TINY)))


@njit(error_model="numpy")
def _fill(
    geom: NDArray[np.int32],
    position: NDArray[np.float32],
    matrix: NDArray[np.float32],
    view: NDArray[np.float32],
    scenery: Scenery,
    grid: TileGrid,
    normal: NDArray[np.float32],
) -> None:
    """Write the normals (H, W, 3) of the pixels that show a geom."""
    camera = matrix_at(view, 3)
    for j in range(geom.shape[0]):
        for i in range(geom.shape[1]):
            g = geom[j, i]
            if g < 0:
                continue
            x, y = sample_point(np.int32(i), np.int32(j), grid)
            p, m = vector_at(position[g], 0), matrix_at(matrix[g], 0)
            origin = to_local(m, (view[0] - p[0], view[1] - p[1], view[2] - p[2]))
            direction = to_local(m, to_parent(camera, (x, y, -ONE)))
            if scenery.kind[g] == MESH:
                n = _mesh_normal(scenery.meshes, g, origin, direction)
            else:
                size = vector_at(scenery.size[g], 0)
                n = _intersect(scenery.kind[g], origin, direction, size)[1]
            normal[j, i, 0], normal[j, i, 1], normal[j, i, 2] = to_parent(m, n)
