"""Shading: the packed colour of a surface under a headlight and a directional light.

MuJoCo's fixed-function shading without specular highlights: per colour channel
``rgb * (emission + sum of ambient + sum over lights of diffuse * max(0, n.l))``, at most 1.
The headlight is directional, along the camera's view, so all lights here are directions.
"""

import numpy as np

from knowarm.world.render.numeric import HALF, ZERO, Matrix, Vector, dot, scalar, times, to_local

FULL = np.float32(255)

Paint = tuple[Vector, Vector, Vector]
"""RGB without light, plus a half for rounding, and RGB that headlight and directional light add at
normal incidence, in 0..255."""


@scalar
def light_geom(
    rgb: Vector, emission: np.float32, lamps: tuple[Vector, Vector, Vector, Vector], matrix: Matrix
) -> tuple[Vector, Paint]:
    """Multiply a geom's colour by the light: the rows of ``read_lamps``.

    Return the unit vector towards the directional light in the geom's frame, and the paint.
    """
    ambient, head, sun, towards_sun = lamps
    r, g, b = times(rgb, FULL)
    dark = (
        r * (ambient[0] + emission) + HALF,
        g * (ambient[1] + emission) + HALF,
        b * (ambient[2] + emission) + HALF,
    )
    paint = (dark, (r * head[0], g * head[1], b * head[2]), (r * sun[0], g * sun[1], b * sun[2]))
    return to_local(matrix, towards_sun), paint


@scalar
def _channel(value: np.float32) -> np.int32:
    """Convert to a byte by rounding down; the paint already holds the half that rounds."""
    return np.int32(min(value, FULL))


@scalar
def shade(normal: Vector, head: Vector, sun: Vector, paint: Paint) -> np.int32:
    """Return red, green and blue of a surface in the lowest three bytes.

    The unit vectors towards headlight and directional light are in the frame of the normal.
    """
    dark, by_head, by_sun = paint
    a, b = max(dot(normal, head), ZERO), max(dot(normal, sun), ZERO)
    red = _channel(dark[0] + a * by_head[0] + b * by_sun[0])
    green = _channel(dark[1] + a * by_head[1] + b * by_sun[1])
    blue = _channel(dark[2] + a * by_head[2] + b * by_sun[2])
    return np.int32(red | np.int32(green << np.int32(8)) | np.int32(blue << np.int32(16)))
