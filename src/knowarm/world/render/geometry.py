"""A ray in a geom's own frame goes in; where it meets the surface, and the normal there, come out.

One function a primitive, all of one form ``f(origin, direction, size) -> (t, normal)``:

- ``origin`` [m] and ``direction`` (any length) are tuples of three float32, ``size`` is
  ``geom_size`` as MuJoCo defines it for the type [m];
- ``t`` is the ray parameter of the first intersection at t >= 0, ``FAR`` for none. A ray that
  begins inside a solid meets its far side, as with ``mj_ray``;
- ``normal`` is the outward unit normal at the intersection; without one it is meaningless.

Solids are convex, so each is an interval of t: entry and exit. The functions choose by selection
instead of branches, which lets the compiler draw eight pixels at once.
"""

import math

import numpy as np

from knowarm.world.render.numeric import FAR, ONE, TINY, ZERO, Vector, along, dot, scalar


@scalar
def plane(origin: Vector, direction: Vector, size: Vector) -> tuple[np.float32, Vector]:
    """Meet z = 0 from above; half-sizes of 0 are without end."""
    down = direction[2] < -TINY
    t = -origin[2] / (direction[2] if down else -ONE)
    x = origin[0] + t * direction[0]
    y = origin[1] + t * direction[1]
    inside = ((size[0] <= ZERO) | (abs(x) <= size[0])) & ((size[1] <= ZERO) | (abs(y) <= size[1]))
    return (t if down & inside & (t >= ZERO) else FAR), (ZERO, ZERO, ONE)


@scalar
def _unit_sphere(origin: Vector, direction: Vector) -> tuple[np.float32, np.float32]:
    """Entry and exit of the sphere of radius 1 (entry > exit: none).

    The discriminant is d.d - |o x d|^2, which does not cancel when the sphere is far away.
    """
    cx = origin[1] * direction[2] - origin[2] * direction[1]
    cy = origin[2] * direction[0] - origin[0] * direction[2]
    cz = origin[0] * direction[1] - origin[1] * direction[0]
    square = dot(direction, direction)
    discriminant = square - (cx * cx + cy * cy + cz * cz)
    root = math.sqrt(max(discriminant, ZERO))
    middle = -dot(origin, direction)
    hit = discriminant >= ZERO
    return (middle - root) / square if hit else FAR, (middle + root) / square if hit else -FAR


@scalar
def sphere(origin: Vector, direction: Vector, size: Vector) -> tuple[np.float32, Vector]:
    """Meet the sphere of radius size[0]."""
    scale = ONE / size[0]
    o = (origin[0] * scale, origin[1] * scale, origin[2] * scale)
    d = (direction[0] * scale, direction[1] * scale, direction[2] * scale)
    entry, leave = _unit_sphere(o, d)
    t = entry if entry >= ZERO else leave
    return (t if (entry <= leave) & (t >= ZERO) else FAR), along(o, t, d)


@scalar
def ellipsoid(origin: Vector, direction: Vector, size: Vector) -> tuple[np.float32, Vector]:
    """Meet the ellipsoid of half-axes size, as the unit sphere in scaled space."""
    sx, sy, sz = ONE / size[0], ONE / size[1], ONE / size[2]
    o = (origin[0] * sx, origin[1] * sy, origin[2] * sz)
    d = (direction[0] * sx, direction[1] * sy, direction[2] * sz)
    entry, leave = _unit_sphere(o, d)
    t = entry if entry >= ZERO else leave
    p = along(o, t, d)
    gradient = (p[0] * sx, p[1] * sy, p[2] * sz)
    scale = ONE / math.sqrt(max(dot(gradient, gradient), TINY))
    normal = (gradient[0] * scale, gradient[1] * scale, gradient[2] * scale)
    return (t if (entry <= leave) & (t >= ZERO) else FAR), normal


@scalar
def _tube(origin: Vector, direction: Vector, radius: np.float32) -> tuple[np.float32, np.float32]:
    """Entry and exit of the endless cylinder around z (entry > exit: none)."""
    square = direction[0] * direction[0] + direction[1] * direction[1]
    cross = origin[0] * direction[1] - origin[1] * direction[0]
    discriminant = square * radius * radius - cross * cross
    root = math.sqrt(max(discriminant, ZERO))
    middle = -(origin[0] * direction[0] + origin[1] * direction[1])
    parallel = square < TINY
    inverse = ONE / (ONE if parallel else square)
    within = origin[0] * origin[0] + origin[1] * origin[1] <= radius * radius
    hit = within if parallel else discriminant >= ZERO
    entry = -FAR if parallel else (middle - root) * inverse
    leave = FAR if parallel else (middle + root) * inverse
    return entry if hit else FAR, leave if hit else -FAR


@scalar
def cylinder(origin: Vector, direction: Vector, size: Vector) -> tuple[np.float32, Vector]:
    """Meet the solid cylinder around z of radius size[0] and half-length size[1]."""
    side_entry, side_leave = _tube(origin, direction, size[0])
    dz = direction[2] if abs(direction[2]) > TINY else TINY
    inverse = ONE / dz
    middle, half = -origin[2] * inverse, abs(size[1] * inverse)
    entry, leave = max(side_entry, middle - half), min(side_leave, middle + half)
    from_outside = entry >= ZERO
    t = entry if from_outside else leave
    on_cap = (entry > side_entry) if from_outside else (leave < side_leave)
    # Seen from outside a cap faces the ray, seen from inside it faces away from it.
    cap = -ONE if (dz > ZERO) == from_outside else ONE
    scale = ONE / size[0]
    nx = (origin[0] + t * direction[0]) * scale
    ny = (origin[1] + t * direction[1]) * scale
    normal = (ZERO if on_cap else nx, ZERO if on_cap else ny, cap if on_cap else ZERO)
    return (t if (entry <= leave) & (t >= ZERO) else FAR), normal


@scalar
def _capsule_end(
    origin: Vector, direction: Vector, size: Vector, t: np.float32, first: bool
) -> tuple[np.float32, np.float32]:
    """Move t from the endless cylinder onto the cap beyond whose rim it lies, if it does."""
    z = origin[2] + t * direction[2]
    centre = min(max(z, -size[1]), size[1])
    scale = ONE / size[0]
    o = (origin[0] * scale, origin[1] * scale, (origin[2] - centre) * scale)
    d = (direction[0] * scale, direction[1] * scale, direction[2] * scale)
    entry, leave = _unit_sphere(o, d)
    on_cap = abs(z) > size[1]
    on_sphere = entry if first else leave
    return on_sphere if on_cap else t, centre if on_cap else z


@scalar
def capsule(origin: Vector, direction: Vector, size: Vector) -> tuple[np.float32, Vector]:
    """Meet the capsule around z of radius size[0] and half-length size[1] without its caps.

    The ray enters the endless cylinder at some height. Between the rims that is the entry; above or
    below, the entry is on the cap of that end, as the way to anything else leads through it.
    """
    side_entry, side_leave = _tube(origin, direction, size[0])
    entry, entry_z = _capsule_end(origin, direction, size, side_entry, True)
    leave, leave_z = _capsule_end(origin, direction, size, side_leave, False)
    from_outside = entry >= ZERO
    t = entry if from_outside else leave
    centre = min(max(entry_z if from_outside else leave_z, -size[1]), size[1])
    p = along(origin, t, direction)
    scale = ONE / size[0]
    hit = (side_entry <= side_leave) & (entry <= leave) & (t >= ZERO)
    return (t if hit else FAR), (p[0] * scale, p[1] * scale, (p[2] - centre) * scale)


@scalar
def _slab(origin: np.float32, direction: np.float32, half: np.float32) -> tuple[np.float32, ...]:
    """Entry and exit of -half <= x <= half along one axis."""
    inverse = ONE / (direction if abs(direction) > TINY else TINY)
    middle, reach = -origin * inverse, abs(half * inverse)
    return middle - reach, middle + reach


@scalar
def box(origin: Vector, direction: Vector, size: Vector) -> tuple[np.float32, Vector]:
    """Meet the box of half-sizes size."""
    x0, x1 = _slab(origin[0], direction[0], size[0])
    y0, y1 = _slab(origin[1], direction[1], size[1])
    z0, z1 = _slab(origin[2], direction[2], size[2])
    entry, leave = max(max(x0, y0), z0), min(min(x1, y1), z1)
    from_outside = entry >= ZERO
    t = entry if from_outside else leave
    on_x = (x0 if from_outside else x1) == t
    on_y = ((y0 if from_outside else y1) == t) & (not on_x)
    facing = -ONE if from_outside else ONE
    nx = facing if direction[0] > ZERO else -facing
    ny = facing if direction[1] > ZERO else -facing
    nz = facing if direction[2] > ZERO else -facing
    normal = (nx if on_x else ZERO, ny if on_y else ZERO, ZERO if on_x | on_y else nz)
    return (t if (entry <= leave) & (t >= ZERO) else FAR), normal
