"""A geom's pose before the camera goes in; the rectangle of image that can show it comes out.

Camera frame: x right, y up, looking along -z. Image coordinates are X = x / -z and Y = y / -z.
A rectangle is (X lower, X upper, Y lower, Y upper); ``EVERYWHERE`` stands for geoms that reach
behind the camera. All rectangles are the exact bounds of the projection.

Sphere, ellipsoid and disc are sets {p + M u, |u| <= 1}. The plane x + X z = 0 through the eye
touches such a set where (n.p)^2 = n.A.n with n = (1, 0, X) and A = M M', a quadratic in X.
Capsule and cylinder are the convex hulls of two spheres and of two discs.
"""

import math

import numpy as np

from knowarm.world.render.numeric import ONE, ZERO, Matrix, Vector, scalar

Rectangle = tuple[np.float32, np.float32, np.float32, np.float32]

WIDE = np.float32(1e6)
EVERYWHERE = (-WIDE, WIDE, -WIDE, WIDE)
NEAR = np.float32(1e-3)
"""Points closer to the eye than this have no useful projection [m]."""


@scalar
def _interval(
    p: np.float32, pz: np.float32, a_xx: np.float32, a_xz: np.float32, a_zz: np.float32
) -> tuple[np.float32, np.float32]:
    """Bounds of x / -z over {p + M u}, where all of it lies before the eye."""
    a = pz * pz - a_zz
    b = p * pz - a_xz
    root = math.sqrt(max(b * b - a * (p * p - a_xx), ZERO))
    inverse = ONE / a
    return (-b - root) * inverse, (-b + root) * inverse


@scalar
def round_bounds(p: Vector, m: Matrix, axes: Vector) -> Rectangle:
    """Bounds of an ellipsoid of half-axes ``axes`` (0 for a disc) at p with rotation m."""
    x, y, z = axes[0] * axes[0], axes[1] * axes[1], axes[2] * axes[2]
    a_zz = m[6] * m[6] * x + m[7] * m[7] * y + m[8] * m[8] * z
    if p[2] + math.sqrt(a_zz) > -NEAR:
        return EVERYWHERE
    a_xx = m[0] * m[0] * x + m[1] * m[1] * y + m[2] * m[2] * z
    a_yy = m[3] * m[3] * x + m[4] * m[4] * y + m[5] * m[5] * z
    a_xz = m[0] * m[6] * x + m[1] * m[7] * y + m[2] * m[8] * z
    a_yz = m[3] * m[6] * x + m[4] * m[7] * y + m[5] * m[8] * z
    x0, x1 = _interval(p[0], p[2], a_xx, a_xz, a_zz)
    y0, y1 = _interval(p[1], p[2], a_yy, a_yz, a_zz)
    return x0, x1, y0, y1


@scalar
def hull(a: Rectangle, b: Rectangle) -> Rectangle:
    """Smallest rectangle around two."""
    return min(a[0], b[0]), max(a[1], b[1]), min(a[2], b[2]), max(a[3], b[3])


@scalar
def long_bounds(p: Vector, m: Matrix, half: np.float32, end: Vector) -> Rectangle:
    """Bounds of the hull of two equal round ends at +-half along the local z axis."""
    dx, dy, dz = m[2] * half, m[5] * half, m[8] * half
    return hull(
        round_bounds((p[0] + dx, p[1] + dy, p[2] + dz), m, end),
        round_bounds((p[0] - dx, p[1] - dy, p[2] - dz), m, end),
    )


@scalar
def box_bounds(p: Vector, m: Matrix, size: Vector) -> Rectangle:
    """Bounds of a box of half-sizes ``size``: its eight corners."""
    x0, x1, y0, y1 = WIDE, -WIDE, WIDE, -WIDE
    for corner in range(8):
        sx = size[0] if corner & 1 else -size[0]
        sy = size[1] if corner & 2 else -size[1]
        sz = size[2] if corner & 4 else -size[2]
        z = p[2] + m[6] * sx + m[7] * sy + m[8] * sz
        if z > -NEAR:
            return EVERYWHERE
        inverse = ONE / -z
        x = (p[0] + m[0] * sx + m[1] * sy + m[2] * sz) * inverse
        y = (p[1] + m[3] * sx + m[4] * sy + m[5] * sz) * inverse
        x0, x1, y0, y1 = min(x0, x), max(x1, x), min(y0, y), max(y1, y)
    return x0, x1, y0, y1
