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


MARKED_RGB, UNMARKED_RGB = (1.0, 0.0, 1.0), (0.72, 0.72, 0.72)
"""Colours of the wanted object and of the others with ``ChoiceConfig.marked``."""


class TargetColours:
    """Colours that show some targets, each in one of its colours, and hide the others.

    Args:
        scene: the targets' geoms and colours.
        place: moves the constants to the device of the computation.
    """

    def __init__(self, scene: Scene, place: Place = here) -> None:
        self._resting = place(resting_colours(scene, 1)[0])
        self._owner = place(scene.geom_target)
        self._coloured = place(scene.geom_coloured)
        self._colours = place(scene.target_colours)
        self._marks = place(np.array([MARKED_RGB, UNMARKED_RGB], dtype=np.float32))

    def __call__(self, target: Array, colour: Array, marked: bool = False) -> Array:
        """Return the colours of every geom, new, (k, G, 4) float32 in 0..1; alpha 0 hides.

        Args:
            target: indices of the visible targets, (k, M) int64, NumPy or torch, or (k,) for one.
            colour: indices into their colours, of the same shape.
            marked: paint the first target in one colour and the others in another.
        """
        xp = array_namespace(target)
        target, colour = (xp.reshape(x, (target.shape[0], -1)) for x in (target, colour))
        rgb, alpha = self._resting[:, :3], self._resting[:, 3:]
        for j in range(target.shape[1]):
            visible = self._owner == target[:, j, None]
            painted = (visible & (self._coloured | marked))[..., None]
            shade = self._colours[target[:, j], colour[:, j]]
            shade = self._marks[min(j, 1)] if marked else shade[:, None, :]
            rgb = xp.where(painted, shade, rgb)
            alpha = xp.astype(visible, xp.float32)[..., None] + alpha
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
        marked: see ``TargetColours``.
    """

    def __init__(
        self,
        scene: Scene,
        randomization: VisualRandomization,
        place: Place = here,
        marked: bool = False,
    ) -> None:
        self._marked = marked
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
        """Compute the appearance of k episodes, NumPy or torch.

        Args:
            target: indices of the visible targets, (k, M) int64.
            colour: indices into their colours, (k, M) int64.
            position: x and y of the first target, (k, 2) [m].
            look: as in ``Episodes``.
        """
        rgba = self._colours(target, colour, self._marked)
        if not self._draws:
            return Shown(rgba, None, None, None)
        seen = self._looks(look, position)
        if seen.surface_rgb is not None:
            rgba[:, self._surfaces, :3] = seen.surface_rgb
        rgba[:, self._distractors, :3] = seen.distractor_rgb
        return Shown(rgba, seen.views, seen.lamps, seen.distractor_position)
