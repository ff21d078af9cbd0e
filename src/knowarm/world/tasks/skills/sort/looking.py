"""Looking at trays: which of the places where trays stand shows which colour."""

import numpy as np
from numpy.linalg import norm
from scipy.optimize import linear_sum_assignment

from knowarm.arrays import Floats, Images, Integers, Names
from knowarm.world.objects.target import COLOURS
from knowarm.world.scene.scene import Scene, project
from knowarm.world.tasks.skills.place.tray import HALF_M, THICK_M

POINTS = 7  # Points per side of a tray at which its colour is read
SHARE = 0.8  # of the tray over which they are spread


def trays_by_colour(
    scene: Scene,
    images: Images,
    centres: Floats,
    colours: Names,
) -> Integers:
    """Find the trays of colours in images by their pixels, without a network.

    Each tray has one of the colours; of all ways to give each its own, it is the one at which most
    pixels are like them.

    Args:
        scene: the camera.
        images: (n, H, W, 3).
        centres: where trays stand, x and y, (K, 2) [m].
        colours: names of those of an episode, in any order, (n, K).

    Returns:
        Number of the tray of each colour, (n, K).
    """
    pixels = _pixels(scene, centres, images.shape[1])
    seen = images[:, pixels[..., 1], pixels[..., 0]].astype(float)  # (n, K, points, 3)
    seen /= norm(seen, axis=3, keepdims=True).clip(min=1.0)
    names = list(COLOURS)
    directions = np.array(list(COLOURS.values()))
    directions /= norm(directions, axis=1, keepdims=True)
    tray_of_colour = np.zeros(colours.shape, np.int64)
    for episode, of_episode in enumerate(colours):
        numbers = [names.index(name) for name in of_episode]
        likeness = seen[episode] @ directions[numbers].T
        # A pixel of an object before the tray counts for one tray only.
        score = (likeness == likeness.max(axis=2, keepdims=True)).mean(axis=1)
        _, tray_of_colour[episode] = linear_sum_assignment(-score.T)
    return tray_of_colour


def _pixels(scene: Scene, centres: Floats, image_size: int) -> Integers:
    """Return columns and rows of points of trays in the image, (K, points, 2)."""
    side = SHARE * HALF_M * np.linspace(-1, 1, POINTS)
    offsets = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    flat = (centres[:, None] + offsets).reshape(-1, 2)
    height = scene.robot.support_height_m + THICK_M
    points = np.column_stack([flat, np.full(len(flat), height)])
    where = (1 + project(scene, points) * [1, -1]) / 2 * image_size
    pixels = where.astype(np.int64).clip(0, image_size - 1)
    return pixels.reshape(len(centres), -1, 2)
