"""Appearance of episodes: colours of the geoms, cameras and lights."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knowarm.world.render.scenery import material_colours
from knowarm.world.scene.looks import LookSource, VisualRandomization
from knowarm.world.scene.scene import Scene


def resting_colours(scene: Scene, num_envs: int) -> NDArray[np.float32]:
    """Return the colours of the model files with all targets hidden, (n, G, 4) in 0..1."""
    model = scene.model
    rgba = model.geom_rgba.copy()
    with_material = model.geom_matid >= 0
    rgba[with_material] = material_colours(model)[model.geom_matid[with_material]]
    rgba[scene.geom_target >= 0, 3] = 0.0
    return np.repeat(rgba[None].astype(np.float32), num_envs, axis=0)


MARKED_RGB, UNMARKED_RGB = (1.0, 0.0, 1.0), (0.72, 0.72, 0.72)
"""Colours of the object to reach and of the others in a task that paints its goal."""


class TargetColours:
    """Colours that show some targets, each in one of its colours, and hide the others."""

    def __init__(self, scene: Scene) -> None:
        self._resting = resting_colours(scene, 1)[0]
        self._owner = scene.geom_target
        self._coloured = scene.geom_coloured
        self._colours = scene.target_colours
        self._marks = np.array([MARKED_RGB, UNMARKED_RGB], dtype=np.float32)

    def __call__(
        self, target: NDArray[np.int64], colour: NDArray[np.int64], marked: bool = False
    ) -> NDArray[np.float32]:
        """Return the colours of every geom, new, (k, G, 4) float32 in 0..1; alpha 0 hides.

        The visible targets and their colours are indices, (k, M), or (k,) for one. ``marked``
        paints the first target in one colour and the others in another.
        """
        target, colour = (x.reshape(len(target), -1) for x in (target, colour))
        rgb, alpha = self._resting[:, :3], self._resting[:, 3:]
        for j in range(target.shape[1]):
            visible = self._owner == target[:, j, None]
            painted = (visible & (self._coloured | marked))[..., None]
            shade = self._colours[target[:, j], colour[:, j]]
            shade = self._marks[min(j, 1)] if marked else shade[:, None, :]
            rgb = np.where(painted, shade, rgb)
            alpha = visible.astype(np.float32)[..., None] + alpha
        return np.concat([rgb, alpha], axis=-1)


class Shown(NamedTuple):
    """Appearance of k environments: the arguments of ``Renderer.draw`` besides the poses."""

    rgba: NDArray[np.float32]  # Colours of the geoms, alpha 0 for hidden ones, (k, G, 4) float32
    views: NDArray[np.float32] | None  # Cameras, (k, 12) float32; None for the camera of the model
    lamps: NDArray[np.float32] | None  # Lights, (k, 4, 3) float32; None for the lights of the model
    # x and y of the distractors [m], (k, D, 2) float64; None without randomization
    distractor_position: NDArray[np.float64] | None


class AppearanceSource:
    """Computes the appearance of episodes; ``marked`` as in ``TargetColours``."""

    def __init__(
        self, scene: Scene, randomization: VisualRandomization, marked: bool = False
    ) -> None:
        self._marked = marked
        self._draws = randomization.draws
        self._colours = TargetColours(scene)
        self._looks = LookSource(scene, randomization)
        self._surfaces = np.array(scene.surface_geoms, dtype=np.intp)
        self._distractors = scene.distractor_geoms

    def __call__(
        self,
        target: NDArray[np.int64],
        colour: NDArray[np.int64],
        position: NDArray[np.float64],
        look: NDArray[np.float64],
    ) -> Shown:
        """Compute the appearance of k episodes.

        Targets and colours are indices (k, M), ``position`` x and y of the first one, (k, 2) [m].
        """
        rgba = self._colours(target, colour, self._marked)
        if not self._draws:
            return Shown(rgba, None, None, None)
        seen = self._looks(look, position)
        if seen.surface_rgb is not None:
            rgba[:, self._surfaces, :3] = seen.surface_rgb
        rgba[:, self._distractors, :3] = seen.distractor_rgb
        return Shown(rgba, seen.views, seen.lamps, seen.distractor_position)
