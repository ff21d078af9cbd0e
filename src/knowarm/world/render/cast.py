"""One sample and one geom go in; whether, where and how the sample shows the geom comes out.

The CPU draws a geom's samples in one loop a type (``fill``). Where each sample is on its own, as in
a CUDA thread, these functions choose the type; both call the same intersection functions.
"""

import numpy as np

from knowarm.world.render import geometry
from knowarm.world.render.numeric import Matrix, Vector, minus, scalar
from knowarm.world.render.shading import Paint, shade
from knowarm.world.render.tables import BOX, CAPSULE, CYLINDER, ELLIPSOID, SPHERE
from knowarm.world.render.triangle import blend, face_planes, meet_triangle


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


@scalar
def sample_direction(x: np.float32, y: np.float32, frame: Matrix) -> Vector:
    """Direction of the ray through image coordinates x, y in a geom's frame."""
    return (
        x * frame[0] + y * frame[3] - frame[6],
        x * frame[1] + y * frame[4] - frame[7],
        x * frame[2] + y * frame[5] - frame[8],
    )


@scalar
def cast_at_geom(
    kind: np.int32, origin: Vector, frame: Matrix, size: Vector, x: np.float32, y: np.float32
) -> tuple[np.float32, Vector]:
    """Depth and normal, in the geom's frame, at which a sample meets a primitive."""
    return meet_geom(kind, origin, sample_direction(x, y, frame), size)


@scalar
def cast_at_triangle(
    origin: Vector, frame: Matrix, a: Vector, b: Vector, c: Vector, x: np.float32, y: np.float32
) -> tuple[np.float32, Vector]:
    """Depth at which a sample meets a triangle of a mesh, and the weights of its corners."""
    planes = face_planes(minus(a, origin), minus(b, origin), minus(c, origin))
    return meet_triangle(sample_direction(x, y, frame), planes)


@scalar
def cast_colour(normal: Vector, frame: Matrix, sun: Vector, colours: Paint) -> np.int32:
    """Packed colour of a surface with this normal, all in the geom's frame."""
    return shade(normal, (frame[6], frame[7], frame[8]), sun, colours)


@scalar
def cast_smooth_colour(
    weights: Vector,
    a: Vector,
    b: Vector,
    c: Vector,
    frame: Matrix,
    sun: Vector,
    colours: Paint,
) -> np.int32:
    """Packed colour between three corners' normals."""
    return cast_colour(blend(weights, a, b, c), frame, sun, colours)
