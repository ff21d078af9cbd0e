"""Appearance of episodes: colours of the geoms, cameras and lights."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knowarm.errors import UserError
from knowarm.world.arrays import Array, Place, array_namespace, here
from knowarm.world.episodes import Episodes
from knowarm.world.render.scenery import material_colours
from knowarm.world.scene import Scene
from knowarm.world.visual_randomization import LookSource, VisualRandomization


def resting_colours(scene: Scene, num_envs: int) -> NDArray[np.float32]:
    """Return the colours of the model files with all targets hidden, (n, G, 4) in 0..1."""
    model = scene.model
    rgba = model.geom_rgba.copy()
    with_material = model.geom_matid >= 0
    rgba[with_material] = material_colours(model)[model.geom_matid[with_material]]
    rgba[scene.geom_target >= 0, 3] = 0.0
    return np.repeat(rgba[None].astype(np.float32), num_envs, axis=0)


class TargetColours:
    """Colours that show one target in one of its colours and hide the others.

    Args:
        scene: the targets' geoms and colours.
        place: moves the constants to the device of the computation.
    """

    def __init__(self, scene: Scene, place: Place = here) -> None:
        self._resting = place(resting_colours(scene, 1)[0])
        self._owner = place(scene.geom_target)
        self._coloured = place(scene.geom_coloured)
        self._colours = place(scene.target_colours)

    def __call__(self, target: Array, colour: Array) -> Array:
        """Return the colours of every geom, new, (k, G, 4) float32 in 0..1; alpha 0 hides.

        Args:
            target: index of the visible target, (k,) int64, NumPy or torch.
            colour: index into its colours, (k,) int64.
        """
        xp = array_namespace(target)
        visible = self._owner == target[:, None]
        own, others = self._resting[:, :3], self._resting[:, 3:]
        painted = (visible & self._coloured)[..., None]
        rgb = xp.where(painted, self._colours[target, colour][:, None, :], own)
        alpha = xp.astype(visible, xp.float32)[..., None] + others
        return xp.concat([rgb, alpha], axis=-1)


class Shown(NamedTuple):
    """Appearance of k environments: the arguments of ``Renderer.draw`` besides the poses."""

    rgba: Array
    """Colours of the geoms, alpha 0 for hidden ones, (k, G, 4) float32."""

    views: Array | None
    """Cameras, (k, 12) float32; None for the camera of the model."""

    lamps: Array | None
    """Lights, (k, 4, 3) float32; None for the lights of the model."""

    distractor_position: Array | None
    """x and y of the distractors [m], (k, D, 2) float64; None without randomization."""


class AppearanceSource:
    """Computes the appearance of episodes, with NumPy or torch.

    Args:
        scene: the objects in the image.
        randomization: what varies in the image.
        place: moves the constants to the device of the computation.
    """

    def __init__(
        self, scene: Scene, randomization: VisualRandomization, place: Place = here
    ) -> None:
        self._draws = randomization.draws
        self._colours = TargetColours(scene, place)
        self._looks = LookSource(scene, randomization, place)
        self._surfaces = place(np.array(scene.surface_geoms, dtype=np.int64))
        self._distractors = place(scene.distractor_geoms.astype(np.int64))

    def check(self, episodes: Episodes) -> None:
        """Check that episodes were drawn for this randomization.

        Raises:
            UserError: their look has the wrong number of draws.
        """
        if episodes.look.shape[1] != self._draws:
            raise UserError(
                f"The episodes hold {episodes.look.shape[1]} draws of visual randomization, and "
                f"this environment needs {self._draws}; draw them with its config."
            )

    def __call__(self, target: Array, colour: Array, position: Array, look: Array) -> Shown:
        """Compute the appearance of k episodes from fields of ``Episodes``, NumPy or torch."""
        rgba = self._colours(target, colour)
        if not self._draws:
            return Shown(rgba, None, None, None)
        seen = self._looks(look, position)
        if seen.surface_rgb is not None:
            rgba[:, self._surfaces, :3] = seen.surface_rgb
        rgba[:, self._distractors, :3] = seen.distractor_rgb
        return Shown(rgba, seen.views, seen.lamps, seen.distractor_position)
