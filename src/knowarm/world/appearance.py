"""Targets and colours of episodes go in; the colour of every geom comes out."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knowarm.errors import UserError
from knowarm.world.arrays import Array, Place, array_namespace, here
from knowarm.world.episodes import Episodes
from knowarm.world.scene import Scene
from knowarm.world.visual_randomization import LookSource, VisualRandomization


def resting_colours(scene: Scene, num_envs: int) -> NDArray[np.float32]:
    """Colours as the model files give them, all targets hidden: (n, G, 4) in 0..1."""
    model = scene.model
    rgba = model.geom_rgba.copy()
    with_material = model.geom_matid >= 0
    rgba[with_material] = model.mat_rgba[model.geom_matid[with_material]]
    rgba[scene.geom_target >= 0, 3] = 0.0
    return np.repeat(rgba[None].astype(np.float32), num_envs, axis=0)


class TargetColours:
    """Shows one target in its colour and hides the others.

    Args:
        scene: where the targets' geoms are.
        place: puts the constants where colours will be computed; on the CPU by default.
    """

    def __init__(self, scene: Scene, place: Place = here) -> None:
        self._resting = place(resting_colours(scene, 1)[0])
        self._owner = place(scene.geom_target)
        self._coloured = place(scene.geom_coloured)
        self._colours = place(scene.target_colours)

    def __call__(self, target: Array, colour: Array) -> Array:
        """Colours of every geom, new, (k, G, 4) float32 in 0..1; alpha 0 hides.

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
    """How k environments look: what ``Renderer.draw`` takes besides the poses."""

    rgba: Array
    """Colours of the geoms, alpha 0 where one is hidden, (k, G, 4) float32."""

    views: Array | None
    """Cameras, (k, 12) float32; None for the model's."""

    lamps: Array | None
    """Lights, (k, 4, 3) float32; None for the model's."""

    distractor_position: Array | None
    """Where distractors stand, x and y [m], (k, D, 2) float64; None when nothing is randomized."""


class AppearanceSource:
    """Computes how episodes look, on the CPU or on a device.

    Args:
        scene: what stands in the image.
        randomization: what varies in it.
        place: puts the constants where looks will be computed; on the CPU by default.
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
        """Refuse episodes that were drawn for another randomization.

        Raises:
            UserError: their look has another number of draws.
        """
        if episodes.look.shape[1] != self._draws:
            raise UserError(
                f"The episodes hold {episodes.look.shape[1]} draws of visual randomization, this "
                f"environment needs {self._draws}: draw them with its config."
            )

    def __call__(self, target: Array, colour: Array, position: Array, look: Array) -> Shown:
        """Show k episodes; takes the fields of ``Episodes``, NumPy or torch."""
        rgba = self._colours(target, colour)
        if not self._draws:
            return Shown(rgba, None, None, None)
        seen = self._looks(look, position)
        if seen.surface_rgb is not None:
            rgba[:, self._surfaces, :3] = seen.surface_rgb
        rgba[:, self._distractors, :3] = seen.distractor_rgb
        return Shown(rgba, seen.views, seen.lamps, seen.distractor_position)


class Appearance:
    """How n environments of the CPU look.

    Attributes:
        rgba: (n, G, 4) float32, alpha 0 where a geom is hidden.
        views: (n, 12) float32 cameras, None for the model's.
        lamps: (n, 4, 3) float32 lights, None for the model's.
    """

    def __init__(self, scene: Scene, randomization: VisualRandomization, num_envs: int) -> None:
        self._source = AppearanceSource(scene, randomization)
        self._count = num_envs
        self.check = self._source.check
        self.rgba = resting_colours(scene, num_envs)
        self.views: NDArray[np.float32] | None = None
        self.lamps: NDArray[np.float32] | None = None

    def show(self, ids: NDArray[np.intp], episodes: Episodes) -> NDArray[np.float64] | None:
        """Make environments look as their episodes want it.

        Args:
            ids: the environments, (k,).
            episodes: theirs, k.

        Returns:
            Where the distractors stand, x and y [m], (k, D, 2); None when nothing is randomized.
        """
        shown = self._source(episodes.target, episodes.colour, episodes.position, episodes.look)
        self.rgba[ids] = shown.rgba
        self.views = self._written(self.views, ids, shown.views)
        self.lamps = self._written(self.lamps, ids, shown.lamps)
        return shown.distractor_position

    def of(
        self, ids: NDArray[np.intp] | slice
    ) -> tuple[NDArray[np.float32], NDArray[np.float32] | None, NDArray[np.float32] | None]:
        """Colours, cameras and lights of some environments."""
        return (
            self.rgba[ids],
            None if self.views is None else self.views[ids],
            None if self.lamps is None else self.lamps[ids],
        )

    def _written(
        self,
        array: NDArray[np.float32] | None,
        ids: NDArray[np.intp],
        values: NDArray[np.float32] | None,
    ) -> NDArray[np.float32] | None:
        """Write values (k, ...) at ids into an array (n, ...) that is made when first needed."""
        if values is None:
            return None
        if array is None:
            array = np.zeros((self._count, *values.shape[1:]), dtype=np.float32)
        array[ids] = values
        return array
