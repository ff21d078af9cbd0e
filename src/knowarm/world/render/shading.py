"""A surface's normal and the lights go in; the packed colour of a pixel comes out.

MuJoCo's fixed-function shading without specular highlights: for each colour channel
``rgb * (emission + sum of ambient + sum over lights of diffuse * max(0, n.l))``, at most 1.
The headlight is directional, along the camera's view, so every light here is a direction.
"""

import numpy as np

from knowarm.world.render.numeric import HALF, ZERO, Vector, dot, scalar

FULL = np.float32(255)

Paint = tuple[Vector, Vector, Vector]
"""Colour without light, plus a half, and what each of the two lights adds to it, 0 to 255."""


@scalar
def paint(rgb: Vector, glow: np.float32, lamps: tuple[Vector, Vector, Vector]) -> Paint:
    """Multiply a geom's colour with the light: the sum of ambients, and two diffuse colours."""
    ambient, first, second = lamps
    r, g, b = rgb[0] * FULL, rgb[1] * FULL, rgb[2] * FULL
    return (
        (
            r * (ambient[0] + glow) + HALF,
            g * (ambient[1] + glow) + HALF,
            b * (ambient[2] + glow) + HALF,
        ),
        (r * first[0], g * first[1], b * first[2]),
        (r * second[0], g * second[1], b * second[2]),
    )


@scalar
def _channel(value: np.float32) -> np.int32:
    """Round down to a byte; the half that rounds to the nearest is in the paint already."""
    return np.int32(min(value, FULL))


@scalar
def shade(normal: Vector, first: Vector, second: Vector, colours: Paint) -> np.int32:
    """Light a surface. Normal and the unit vectors towards both lights share one frame."""
    dark, head, sun = colours
    a, b = max(dot(normal, first), ZERO), max(dot(normal, second), ZERO)
    red = _channel(dark[0] + a * head[0] + b * sun[0])
    green = _channel(dark[1] + a * head[1] + b * sun[1])
    blue = _channel(dark[2] + a * head[2] + b * sun[2])
    return np.int32(red | np.int32(green << np.int32(8)) | np.int32(blue << np.int32(16)))
