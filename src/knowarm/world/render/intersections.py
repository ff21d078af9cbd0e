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

from math import sqrt

from numpy import float32

from knowarm.world.render.numeric import (
    FAR,
    ONE,
    TINY,
    ZERO,
    Matrix,
    Vector,
    cross,
    dot,
    minus,
    point_at,
    product,
    scalar,
    times,
    to_local,
    unit,
)

# MuJoCo's geom types as plain numbers for compiled code
PLANE = 0
SPHERE = 2
CAPSULE = 3
ELLIPSOID = 4
CYLINDER = 5
BOX = 6
MESH = 7

# Geom types that can be drawn
SUPPORTED = (PLANE, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH)
# Ray parameters at which a ray enters and leaves a solid
Interval = tuple[float32, float32]
Hit = tuple[float32, Vector]  # Ray parameter and normal
Faces = tuple[Vector, Vector, Vector, Vector, float32]
"""b x c, c x a, a x b, the plane's normal (a - c) x (b - c), and the normal times a."""


@scalar
def plane(origin: Vector, direction: Vector, size: Vector) -> Hit:
    """Intersect z = 0 from above; a half-size of 0 is infinite."""
    half_x, half_y, _ = size
    _, _, height = origin
    _, _, slope = direction
    down = slope < -TINY
    divisor = slope if down else -ONE
    t = -height / divisor
    x, y, _ = point_at(origin, t, direction)
    in_x = (half_x <= ZERO) | (abs(x) <= half_x)
    in_y = (half_y <= ZERO) | (abs(y) <= half_y)
    hit = down & in_x & in_y & (t >= ZERO)
    return t if hit else FAR, (ZERO, ZERO, ONE)


@scalar
def _first(enter: float32, leave: float32) -> float32:
    """Return the first t >= 0 at an end of the interval inside a solid, ``FAR`` for none."""
    t = enter if enter >= ZERO else leave
    hit = (enter <= leave) & (t >= ZERO)
    return t if hit else FAR


@scalar
def _interval_if(hit: bool, enter: float32, leave: float32) -> Interval:
    """Return an interval, or an empty one, which ends before it begins."""
    return enter if hit else FAR, leave if hit else -FAR


@scalar
def _unit_sphere(origin: Vector, direction: Vector) -> Interval:
    """Return the interval inside the sphere of radius 1 (enter > leave for none).

    The discriminant is d.d - |o x d|^2, which does not cancel when the sphere is far away.
    """
    normal = cross(origin, direction)
    square = dot(direction, direction)
    discriminant = square - dot(normal, normal)
    root = sqrt(max(discriminant, ZERO))
    middle = -dot(origin, direction)
    enter = (middle - root) / square
    leave = (middle + root) / square
    return _interval_if(discriminant >= ZERO, enter, leave)


@scalar
def sphere(origin: Vector, direction: Vector, size: Vector) -> Hit:
    """Intersect the sphere of radius size[0]."""
    scale = ONE / size[0]
    o = times(origin, scale)
    d = times(direction, scale)
    enter, leave = _unit_sphere(o, d)
    t = _first(enter, leave)
    return t, point_at(o, t, d)


@scalar
def ellipsoid(origin: Vector, direction: Vector, size: Vector) -> Hit:
    """Intersect the ellipsoid of half-axes size, which is the unit sphere in scaled space."""
    half_x, half_y, half_z = size
    scale = (ONE / half_x, ONE / half_y, ONE / half_z)
    o = product(origin, scale)
    d = product(direction, scale)
    enter, leave = _unit_sphere(o, d)
    t = _first(enter, leave)
    gradient = product(point_at(o, t, d), scale)
    return t, unit(gradient, TINY)


@scalar
def _tube(origin: Vector, direction: Vector, radius: float32) -> Interval:
    """Return the interval inside the infinite cylinder around z (enter > leave for none)."""
    ox, oy, _ = origin
    dx, dy, _ = direction
    square = dx * dx + dy * dy
    moment = ox * dy - oy * dx
    discriminant = square * radius * radius - moment * moment
    root = sqrt(max(discriminant, ZERO))
    middle = -(ox * dx + oy * dy)
    parallel = square < TINY
    divisor = ONE if parallel else square
    inverse = ONE / divisor
    inside = ox * ox + oy * oy <= radius * radius
    hit = inside if parallel else discriminant >= ZERO
    enter = -FAR if parallel else (middle - root) * inverse
    leave = FAR if parallel else (middle + root) * inverse
    return _interval_if(hit, enter, leave)


@scalar
def _not_zero(direction: float32) -> float32:
    """Return a component of a direction by which one can divide."""
    return direction if abs(direction) > TINY else TINY


@scalar
def _slab(origin: float32, direction: float32, half: float32) -> Interval:
    """Return the interval inside -half <= x <= half along one axis."""
    inverse = ONE / _not_zero(direction)
    middle = -origin * inverse
    reach = abs(half * inverse)
    return middle - reach, middle + reach


@scalar
def _facing(direction: float32, from_outside: bool) -> float32:
    """Return the sign of a face's normal along an axis.

    A face hit from outside faces the ray; hit from inside, it faces away from it.
    """
    return -ONE if (direction > ZERO) == from_outside else ONE


@scalar
def cylinder(origin: Vector, direction: Vector, size: Vector) -> Hit:
    """Intersect the solid cylinder around z of radius size[0] and half-length size[1]."""
    radius, half, _ = size
    slope = _not_zero(direction[2])
    side_enter, side_leave = _tube(origin, direction, radius)
    cap_enter, cap_leave = _slab(origin[2], slope, half)
    enter = max(side_enter, cap_enter)
    leave = min(side_leave, cap_leave)
    from_outside = enter >= ZERO
    on_cap = (enter > side_enter) if from_outside else (leave < side_leave)
    cap = _facing(slope, from_outside)
    t = _first(enter, leave)
    nx, ny, _ = times(point_at(origin, t, direction), ONE / radius)
    return t, (ZERO if on_cap else nx, ZERO if on_cap else ny, cap if on_cap else ZERO)


@scalar
def _capsule_end(
    origin: Vector, direction: Vector, size: Vector, t: float32, first: bool
) -> tuple[float32, float32]:
    """Correct t, an intersection with the infinite cylinder, where the ray hits a cap instead.

    Return t and the z of the cap's centre, of the point itself between the rims.
    """
    radius, half, _ = size
    _, _, z = point_at(origin, t, direction)
    centre = min(max(z, -half), half)
    scale = ONE / radius
    from_centre = minus(origin, (ZERO, ZERO, centre))
    enter, leave = _unit_sphere(times(from_centre, scale), times(direction, scale))
    on_cap = abs(z) > half
    on_sphere = enter if first else leave
    return on_sphere if on_cap else t, centre


@scalar
def capsule(origin: Vector, direction: Vector, size: Vector) -> Hit:
    """Intersect the capsule around z of radius size[0] and half-length size[1] without its caps.

    The ray enters the infinite cylinder at some height. Between the rims that point is the
    intersection; above or below, it lies on the cap of that end, because the ray passes through
    that cap before it can reach the rest.
    """
    radius = size[0]
    side_enter, side_leave = _tube(origin, direction, radius)
    enter, enter_centre = _capsule_end(origin, direction, size, side_enter, True)
    leave, leave_centre = _capsule_end(origin, direction, size, side_leave, False)
    centre = enter_centre if enter >= ZERO else leave_centre
    t = _first(enter, leave)
    from_centre = minus(point_at(origin, t, direction), (ZERO, ZERO, centre))
    return t if side_enter <= side_leave else FAR, times(from_centre, ONE / radius)


@scalar
def box(origin: Vector, direction: Vector, size: Vector) -> Hit:
    """Intersect the box of half-sizes size."""
    dx, dy, dz = direction
    enter_x, leave_x = _slab(origin[0], dx, size[0])
    enter_y, leave_y = _slab(origin[1], dy, size[1])
    enter_z, leave_z = _slab(origin[2], dz, size[2])
    enter = max(enter_x, enter_y, enter_z)
    leave = min(leave_x, leave_y, leave_z)
    from_outside = enter >= ZERO
    t = enter if from_outside else leave
    t_x = enter_x if from_outside else leave_x
    t_y = enter_y if from_outside else leave_y
    on_x = t == t_x
    on_y = t == t_y
    nx = _facing(dx, from_outside) if on_x else ZERO
    ny = _facing(dy, from_outside) if on_y & (not on_x) else ZERO
    nz = ZERO if on_x | on_y else _facing(dz, from_outside)
    return _first(enter, leave), (nx, ny, nz)


@scalar
def face_planes(a: Vector, b: Vector, c: Vector) -> Faces:
    """Compute the planes through origin and edges, and the triangle's own plane."""
    normal = cross(minus(a, c), minus(b, c))
    return cross(b, c), cross(c, a), cross(a, b), normal, dot(normal, a)


@scalar
def triangle(planes: Faces, direction: Vector) -> Hit:
    """Intersect a triangle: the ray parameter and the corners' weights, up to a factor."""
    facing_a, facing_b, facing_c, normal, distance = planes
    u = dot(direction, facing_a)
    v = dot(direction, facing_b)
    w = dot(direction, facing_c)
    inside = (min(u, v, w) >= ZERO) | (max(u, v, w) <= ZERO)
    slope = dot(direction, normal)
    flat = slope == ZERO
    divisor = ONE if flat else slope
    t = distance / divisor
    hit = inside & (not flat) & (t >= ZERO)
    return t if hit else FAR, (u, v, w)


@scalar
def blend(weights: Vector, normals: Matrix) -> Vector:
    """Interpolate the unit normal between the normals of three corners."""
    u, v, w = weights
    sign = ONE if u + v + w >= ZERO else -ONE
    return unit(to_local(normals, times(weights, sign)), TINY * TINY)
