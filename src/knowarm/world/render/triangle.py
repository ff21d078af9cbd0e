"""A triangle and a ray from the eye go in; where they meet comes out.

With the corners a, b, c relative to the eye, a direction d meets the triangle if d.(b x c),
d.(c x a) and d.(a x b) have one sign: they are the weights of the three corners, up to a factor.
Triangles that share an edge compute the same number for it with opposite signs, so no ray slips
between them. Both sides of a triangle can be met, as with ``mj_ray``.
"""

import math

import numpy as np

from knowarm.world.render.numeric import FAR, ONE, TINY, ZERO, Vector, cross, dot, minus, scalar

Faces = tuple[Vector, Vector, Vector, Vector, np.float32]
"""b x c, c x a, a x b, the plane's normal (a - c) x (b - c), and the normal times a."""


@scalar
def face_planes(a: Vector, b: Vector, c: Vector) -> Faces:
    """Planes through eye and edge, and the triangle's own, of corners relative to the eye."""
    normal = cross(minus(a, c), minus(b, c))
    return cross(b, c), cross(c, a), cross(a, b), normal, dot(normal, a)


@scalar
def meet_triangle(direction: Vector, planes: Faces) -> tuple[np.float32, Vector]:
    """Ray parameter (``FAR`` for none) and the weights of the corners, up to a factor."""
    u, v, w = dot(direction, planes[0]), dot(direction, planes[1]), dot(direction, planes[2])
    inside = ((u >= ZERO) & (v >= ZERO) & (w >= ZERO)) | ((u <= ZERO) & (v <= ZERO) & (w <= ZERO))
    slope = dot(direction, planes[3])
    flat = slope == ZERO
    t = planes[4] / (ONE if flat else slope)
    return (t if inside & (not flat) & (t >= ZERO) else FAR), (u, v, w)


@scalar
def blend(weights: Vector, a: Vector, b: Vector, c: Vector) -> Vector:
    """Unit normal between the normals of three corners."""
    total = weights[0] + weights[1] + weights[2]
    sign = ONE if total >= ZERO else -ONE
    u, v, w = weights[0] * sign, weights[1] * sign, weights[2] * sign
    x = u * a[0] + v * b[0] + w * c[0]
    y = u * a[1] + v * b[1] + w * c[1]
    z = u * a[2] + v * b[2] + w * c[2]
    scale = ONE / math.sqrt(max(x * x + y * y + z * z, TINY * TINY))
    return x * scale, y * scale, z * scale
