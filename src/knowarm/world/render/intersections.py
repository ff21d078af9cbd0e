"""Intersections of a ray with MuJoCo's primitive geoms and with triangles.

The functions of primitives share one signature, ``f(origin, direction, size) -> (t, normal)``, in
the geom's frame:

- ``origin`` [m] and ``direction`` (of any length) are tuples of three float32, ``size`` is
  ``geom_size`` as MuJoCo defines it for the type [m];
- ``t`` is the ray parameter of the first intersection with t >= 0, ``FAR`` for none. A ray that
  starts inside a solid hits its far side, as with ``mj_ray``;
- ``normal`` is the outward unit normal at the intersection, undefined where there is none.

Solids are convex, so a ray is inside each for one interval of t, from ``enter`` to ``leave``. The
functions select values instead of branching, which lets the compiler vectorize over samples.

A triangle with corners a, b, c relative to the ray's origin is hit by a direction d if d.(b x c),
d.(c x a) and d.(a x b) have one sign; up to a factor, these are the weights of the three corners.
Triangles that share an edge compute the same number for it with opposite signs, so no ray passes
between them. Both sides of a triangle are hit, as with ``mj_ray``.
"""

import math

import numpy as np

from knowarm.world.render.numeric import (
    FAR,
    ONE,
    TINY,
    ZERO,
    Vector,
    cross,
    dot,
    minus,
    point_at,
    scalar,
    times,
)

PLANE, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH = 0, 2, 3, 4, 5, 6, 7
"""MuJoCo's geom types as plain numbers for compiled code."""

SUPPORTED = (PLANE, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH)  # Geom types that can be drawn
Hit = tuple[np.float32, Vector]  # Ray parameter and normal
Faces = tuple[Vector, Vector, Vector, Vector, np.float32]
"""b x c, c x a, a x b, the plane's normal (a - c) x (b - c), and the normal times a."""


@scalar
def plane(origin: Vector, direction: Vector, size: Vector) -> Hit:
    """Intersect z = 0 from above; a half-size of 0 is infinite."""
    down = direction[2] < -TINY
    t = -origin[2] / (direction[2] if down else -ONE)
    x = origin[0] + t * direction[0]
    y = origin[1] + t * direction[1]
    inside = ((size[0] <= ZERO) | (abs(x) <= size[0])) & ((size[1] <= ZERO) | (abs(y) <= size[1]))
    return (t if down & inside & (t >= ZERO) else FAR), (ZERO, ZERO, ONE)


@scalar
def _unit_sphere(origin: Vector, direction: Vector) -> tuple[np.float32, np.float32]:
    """Return the interval inside the sphere of radius 1 (enter > leave for none).

    The discriminant is d.d - |o x d|^2, which does not cancel when the sphere is far away.
    """
    normal = cross(origin, direction)
    square = dot(direction, direction)
    discriminant = square - dot(normal, normal)
    root = math.sqrt(max(discriminant, ZERO))
    middle = -dot(origin, direction)
    hit = discriminant >= ZERO
    return (middle - root) / square if hit else FAR, (middle + root) / square if hit else -FAR


@scalar
def sphere(origin: Vector, direction: Vector, size: Vector) -> Hit:
    """Intersect the sphere of radius size[0]."""
    scale = ONE / size[0]
    o, d = times(origin, scale), times(direction, scale)
    enter, leave = _unit_sphere(o, d)
    t = enter if enter >= ZERO else leave
    return (t if (enter <= leave) & (t >= ZERO) else FAR), point_at(o, t, d)


@scalar
def ellipsoid(origin: Vector, direction: Vector, size: Vector) -> Hit:
    """Intersect the ellipsoid of half-axes size, which is the unit sphere in scaled space."""
    sx, sy, sz = ONE / size[0], ONE / size[1], ONE / size[2]
    o = (origin[0] * sx, origin[1] * sy, origin[2] * sz)
    d = (direction[0] * sx, direction[1] * sy, direction[2] * sz)
    enter, leave = _unit_sphere(o, d)
    t = enter if enter >= ZERO else leave
    p = point_at(o, t, d)
    gradient = (p[0] * sx, p[1] * sy, p[2] * sz)
    normal = times(gradient, ONE / math.sqrt(max(dot(gradient, gradient), TINY)))
    return (t if (enter <= leave) & (t >= ZERO) else FAR), normal


@scalar
def _tube(origin: Vector, direction: Vector, radius: np.float32) -> tuple[np.float32, np.float32]:
    """Return the interval inside the infinite cylinder around z (enter > leave for none)."""
    square = direction[0] * direction[0] + direction[1] * direction[1]
    moment = origin[0] * direction[1] - origin[1] * direction[0]
    discriminant = square * radius * radius - moment * moment
    root = math.sqrt(max(discriminant, ZERO))
    middle = -(origin[0] * direction[0] + origin[1] * direction[1])
    parallel = square < TINY
    inverse = ONE / (ONE if parallel else square)
    within = origin[0] * origin[0] + origin[1] * origin[1] <= radius * radius
    hit = within if parallel else discriminant >= ZERO
    enter = -FAR if parallel else (middle - root) * inverse
    leave = FAR if parallel else (middle + root) * inverse
    return enter if hit else FAR, leave if hit else -FAR


@scalar
def cylinder(origin: Vector, direction: Vector, size: Vector) -> Hit:
    """Intersect the solid cylinder around z of radius size[0] and half-length size[1]."""
    side_enter, side_leave = _tube(origin, direction, size[0])
    dz = direction[2] if abs(direction[2]) > TINY else TINY
    inverse = ONE / dz
    middle, half = -origin[2] * inverse, abs(size[1] * inverse)
    enter, leave = max(side_enter, middle - half), min(side_leave, middle + half)
    from_outside = enter >= ZERO
    t = enter if from_outside else leave
    on_cap = (enter > side_enter) if from_outside else (leave < side_leave)
    # A cap hit from outside faces the ray; hit from inside, it faces away from it.
    cap = -ONE if (dz > ZERO) == from_outside else ONE
    scale = ONE / size[0]
    nx = (origin[0] + t * direction[0]) * scale
    ny = (origin[1] + t * direction[1]) * scale
    normal = (ZERO if on_cap else nx, ZERO if on_cap else ny, cap if on_cap else ZERO)
    return (t if (enter <= leave) & (t >= ZERO) else FAR), normal


@scalar
def _capsule_end(
    origin: Vector, direction: Vector, size: Vector, t: np.float32, first: bool
) -> tuple[np.float32, np.float32]:
    """Correct t, an intersection with the infinite cylinder, where the ray hits a cap instead.

    Return t and the z of the cap's centre (of the point itself between the rims).
    """
    z = origin[2] + t * direction[2]
    centre = min(max(z, -size[1]), size[1])
    scale = ONE / size[0]
    o = (origin[0] * scale, origin[1] * scale, (origin[2] - centre) * scale)
    enter, leave = _unit_sphere(o, times(direction, scale))
    on_cap = abs(z) > size[1]
    on_sphere = enter if first else leave
    return on_sphere if on_cap else t, centre if on_cap else z


@scalar
def capsule(origin: Vector, direction: Vector, size: Vector) -> Hit:
    """Intersect the capsule around z of radius size[0] and half-length size[1] without its caps.

    The ray enters the infinite cylinder at some height. Between the rims that point is the
    intersection; above or below, it lies on the cap of that end, because the ray passes through
    that cap before it can reach the rest.
    """
    side_enter, side_leave = _tube(origin, direction, size[0])
    enter, enter_z = _capsule_end(origin, direction, size, side_enter, True)
    leave, leave_z = _capsule_end(origin, direction, size, side_leave, False)
    from_outside = enter >= ZERO
    t = enter if from_outside else leave
    centre = min(max(enter_z if from_outside else leave_z, -size[1]), size[1])
    p = point_at(origin, t, direction)
    scale = ONE / size[0]
    hit = (side_enter <= side_leave) & (enter <= leave) & (t >= ZERO)
    return (t if hit else FAR), (p[0] * scale, p[1] * scale, (p[2] - centre) * scale)


@scalar
def _slab(
    origin: np.float32, direction: np.float32, half: np.float32
) -> tuple[np.float32, np.float32]:
    """Return the interval inside -half <= x <= half along one axis."""
    inverse = ONE / (direction if abs(direction) > TINY else TINY)
    middle, reach = -origin * inverse, abs(half * inverse)
    return middle - reach, middle + reach


@scalar
def box(origin: Vector, direction: Vector, size: Vector) -> Hit:
    """Intersect the box of half-sizes size."""
    x0, x1 = _slab(origin[0], direction[0], size[0])
    y0, y1 = _slab(origin[1], direction[1], size[1])
    z0, z1 = _slab(origin[2], direction[2], size[2])
    enter, leave = max(max(x0, y0), z0), min(min(x1, y1), z1)
    from_outside = enter >= ZERO
    t = enter if from_outside else leave
    on_x = (x0 if from_outside else x1) == t
    on_y = ((y0 if from_outside else y1) == t) & (not on_x)
    facing = -ONE if from_outside else ONE
    nx = facing if direction[0] > ZERO else -facing
    ny = facing if direction[1] > ZERO else -facing
    nz = facing if direction[2] > ZERO else -facing
    normal = (nx if on_x else ZERO, ny if on_y else ZERO, ZERO if on_x | on_y else nz)
    return (t if (enter <= leave) & (t >= ZERO) else FAR), normal


@scalar
def face_planes(a: Vector, b: Vector, c: Vector) -> Faces:
    """Compute the planes through origin and edges, and the triangle's own plane."""
    normal = cross(minus(a, c), minus(b, c))
    return cross(b, c), cross(c, a), cross(a, b), normal, dot(normal, a)


@scalar
def triangle(planes: Faces, direction: Vector) -> Hit:
    """Intersect a triangle: the ray parameter and the corners' weights, up to a factor."""
    u, v, w = dot(direction, planes[0]), dot(direction, planes[1]), dot(direction, planes[2])
    inside = ((u >= ZERO) & (v >= ZERO) & (w >= ZERO)) | ((u <= ZERO) & (v <= ZERO) & (w <= ZERO))
    slope = dot(direction, planes[3])
    flat = slope == ZERO
    t = planes[4] / (ONE if flat else slope)
    return (t if inside & (not flat) & (t >= ZERO) else FAR), (u, v, w)


@scalar
def blend(weights: Vector, a: Vector, b: Vector, c: Vector) -> Vector:
    """Interpolate the unit normal between the normals of three corners."""
    total = weights[0] + weights[1] + weights[2]
    sign = ONE if total >= ZERO else -ONE
    u, v, w = weights[0] * sign, weights[1] * sign, weights[2] * sign
    x = u * a[0] + v * b[0] + w * c[0]
    y = u * a[1] + v * b[1] + w * c[1]
    z = u * a[2] + v * b[2] + w * c[2]
    return times((x, y, z), ONE / math.sqrt(max(x * x + y * y + z * z, TINY * TINY)))


@scalar
def smooth_triangle(
    planes: Faces, direction: Vector, normals: tuple[Vector, Vector, Vector]
) -> Hit:
    """Intersect a triangle, with the unit normal interpolated between its corners' normals."""
    t, weights = triangle(planes, direction)
    return t, blend(weights, normals[0], normals[1], normals[2])
