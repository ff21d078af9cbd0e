"""A surface's normal and the lights go in; the packed colour of a pixel comes out.

MuJoCo's fixed-function shading without specular highlights: for each colour channel
``rgb * (emission + sum of ambient + sum over lights of diffuse * max(0, n.l))``, at most 1.
The headlight is directional, along the camera's view, so every light here is a direction.
"""

import numpy as np

from knowarm.world.raycast.numeric import HALF, ONE, ZERO, Vector, dot, scalar

FULL = np.float32(255)

Paint = tuple[Vector, Vector, Vector]
"""Colour of a geom where no light shines, and what each of the two lights adds to it, 0 to 1."""


@scalar
def paint(rgb: Vector, glow: np.float32, lamps: tuple[Vector, Vector, Vector]) -> Paint:
    """Multiply a geom's colour with the light: the sum of ambients, and two diffuse colours."""
    ambient, first, second = lamps
    return (
        (rgb[0] * (ambient[0] + glow), rgb[1] * (ambient[1] + glow), rgb[2] * (ambient[2] + glow)),
        (rgb[0] * first[0], rgb[1] * first[1], rgb[2] * first[2]),
        (rgb[0] * second[0], rgb[1] * second[1], rgb[2] * second[2]),
    )


@scalar
def pack(red: np.float32, green: np.float32, blue: np.float32) -> np.int32:
    """Put a colour of 0 to 1 a channel (more is clipped) into one integer, red lowest."""
    r = np.int32(min(red, ONE) * FULL + HALF)
    g = np.int32(min(green, ONE) * FULL + HALF)
    b = np.int32(min(blue, ONE) * FULL + HALF)
    return np.int32(r | (g << np.int32(8)) | (b << np.int32(16)))


@scalar
def shade(normal: Vector, first: Vector, second: Vector, colours: Paint) -> np.int32:
    """Light a surface. Normal and the unit vectors towards both lights share one frame."""
    dark, head, sun = colours
    a, b = max(dot(normal, first), ZERO), max(dot(normal, second), ZERO)
    return pack(
        dark[0] + a * head[0] + b * sun[0],
        dark[1] + a * head[1] + b * sun[1],
        dark[2] + a * head[2] + b * sun[2],
    )
