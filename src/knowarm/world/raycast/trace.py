"""Planes that were drawn go in; geom ids, distances and normals of the pixels come out."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from knowarm.world.raycast import geometry
from knowarm.world.raycast.numeric import (
    Grid,
    Look,
    Planes,
    Vector,
    dot,
    scalar,
    to_local,
    to_parent,
)
from knowarm.world.raycast.render import nine, triple
from knowarm.world.raycast.tables import BOX, CAPSULE, CYLINDER, ELLIPSOID, SPHERE


@scalar
def meet_geom(
    kind: np.int32, origin: Vector, direction: Vector, size: Vector
) -> tuple[np.float32, Vector]:
    """Meet one geom of any primitive type: t and normal in its frame."""
    if kind == BOX:
        return geometry.box(origin, direction, size)
    if kind == CYLINDER:
        return geometry.cylinder(origin, direction, size)
    if kind == CAPSULE:
        return geometry.capsule(origin, direction, size)
    if kind == SPHERE:
        return geometry.sphere(origin, direction, size)
    if kind == ELLIPSOID:
        return geometry.ellipsoid(origin, direction, size)
    return geometry.plane(origin, direction, size)


@njit(error_model="numpy", nogil=True, cache=True)
def trace_planes(
    planes: Planes,
    positions: NDArray[np.float32],
    matrices: NDArray[np.float32],
    view: NDArray[np.float32],
    look: Look,
    grid: Grid,
    geom: NDArray[np.int32],
    distance: NDArray[np.float32],
    normal: NDArray[np.float32],
) -> None:
    """Write what the planes of one environment show.

    Args:
        planes: depth, owner and colour, as drawn.
        positions: (G, 3) world positions.
        matrices: (G, 9) rotations from geom to world.
        view: (12,) camera.
        look: kind, size and glow of the geoms.
        grid: picture coordinates of the first pixel, and a pixel's size.
        geom: (H, W) to write ids into.
        distance: (H, W) to write distances [m] into.
        normal: (H, W, 3) to write world normals into.
    """
    left, top, pixel = grid
    eye = (view[0], view[1], view[2])
    camera = (
        view[3], view[4], view[5], view[6], view[7], view[8], view[9], view[10], view[11],
    )  # fmt: skip
    for j in range(geom.shape[0]):
        for i in range(geom.shape[1]):
            g = planes[1][j, i]
            geom[j, i] = g
            distance[j, i] = -1
            normal[j, i] = 0
            if g < 0:
                continue
            ray = (left + np.float32(i) * pixel, top - np.float32(j) * pixel, np.float32(-1))
            distance[j, i] = planes[0][j, i] * math.sqrt(dot(ray, ray))
            p, matrix = triple(positions, g), nine(matrices, g)
            origin = to_local(matrix, (eye[0] - p[0], eye[1] - p[1], eye[2] - p[2]))
            direction = to_local(matrix, to_parent(camera, ray))
            n = to_parent(matrix, meet_geom(look[0][g], origin, direction, triple(look[1], g))[1])
            normal[j, i, 0], normal[j, i, 1], normal[j, i, 2] = n[0], n[1], n[2]
