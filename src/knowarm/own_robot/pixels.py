"""Pixels that show something: differences between images with and without it."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from knowarm.arrays import Integers, Mask
from knowarm.world.scene.compose import ROBOT_PREFIX
from knowarm.world.scene.scene import Scene

DIFFERENCE = 25
"""Change of a colour channel from which a pixel counts as showing the target, of 255."""


def different_pixels(a: NDArray[Any], b: NDArray[np.int16]) -> Integers:
    """Count the pixels in which images (..., H, W, 3) differ, (...)."""
    return np.asarray((np.abs(a - b).max(axis=-1) > DIFFERENCE).sum(axis=(-2, -1)))


def robot_parts(scene: Scene) -> Mask:
    """Return which geoms are the robot's, (G,): those of its file may have no names."""
    names = [scene.model.geom(g).name for g in range(scene.model.ngeom)]
    return np.array([not name or name.startswith(ROBOT_PREFIX) for name in names])
