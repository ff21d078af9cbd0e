"""Targets and colours of episodes go in; the colour of every geom comes out."""

import numpy as np
from numpy.typing import NDArray

from knowarm.errors import UserError
from knowarm.world.episodes import Episodes
from knowarm.world.looks import looks
from knowarm.world.scene import Scene
from knowarm.world.visual_randomization import VisualRandomization


def resting_colours(scene: Scene, num_envs: int) -> NDArray[np.float32]:
    """Colours as the model files give them, all targets hidden: (n, G, 4) in 0..1."""
    model = scene.model
    rgba = model.geom_rgba.copy()
    with_material = model.geom_matid >= 0
    rgba[with_material] = model.mat_rgba[model.geom_matid[with_material]]
    rgba[scene.geom_target >= 0, 3] = 0.0
    return np.repeat(rgba[None].astype(np.float32), num_envs, axis=0)


def show_targets(
    scene: Scene,
    geom_rgba: NDArray[np.float32],
    ids: NDArray[np.intp],
    target: NDArray[np.int64],
    colour: NDArray[np.int64],
) -> None:
    """Show one target in its colour and hide the others, in place.

    Args:
        scene: where the targets' geoms are.
        geom_rgba: (n, G, 4), written at ``ids``.
        ids: the environments, (k,).
        target: index of the visible target, (k,).
        colour: index into its colours, (k,).
    """
    geoms = np.flatnonzero(scene.geom_target >= 0)
    visible = scene.geom_target[geoms] == target[:, None]
    painted = visible & scene.geom_coloured[geoms]
    rgb = scene.target_colours[target, colour][:, None, :]
    at = ids[:, None], geoms
    geom_rgba[(*at, slice(3))] = np.where(painted[..., None], rgb, geom_rgba[(*at, slice(3))])
    geom_rgba[(*at, 3)] = visible


class Appearance:
    """How n environments look: what ``Pictures.draw`` takes besides the poses.

    Attributes:
        rgba: (n, G, 4) float32, alpha 0 where a geom is hidden.
        views: (n, 12) float32 cameras, None for the model's.
        lamps: (n, 4, 3) float32 lights, None for the model's.
    """

    def __init__(self, scene: Scene, randomization: VisualRandomization, num_envs: int) -> None:
        self._scene = scene
        self._randomization = randomization
        self._count = num_envs
        self.rgba = resting_colours(scene, num_envs)
        self.views: NDArray[np.float32] | None = None
        self.lamps: NDArray[np.float32] | None = None

    def check(self, episodes: Episodes) -> None:
        """Refuse episodes that were drawn for another randomization.

        Raises:
            UserError: their look has another number of draws.
        """
        if episodes.look.shape[1] != self._randomization.draws:
            raise UserError(
                f"The episodes hold {episodes.look.shape[1]} draws of visual randomization, this "
                f"environment needs {self._randomization.draws}: draw them with its config."
            )

    def show(self, ids: NDArray[np.intp], episodes: Episodes) -> NDArray[np.float64] | None:
        """Make environments look as their episodes want it.

        Args:
            ids: the environments, (k,).
            episodes: theirs, k.

        Returns:
            Where the distractors stand, x and y [m], (k, D, 2); None when nothing is randomized.
        """
        scene = self._scene
        show_targets(scene, self.rgba, ids, episodes.target, episodes.colour)
        if not self._randomization.draws:
            return None
        look = looks(scene, self._randomization, episodes.look, episodes.position)
        self.views = self._written(self.views, ids, look.views)
        self.lamps = self._written(self.lamps, ids, look.lamps)
        if look.surface_rgb is not None:
            self.rgba[ids[:, None], list(scene.surface_geoms), :3] = look.surface_rgb
        if len(scene.distractor_geoms):
            self.rgba[ids[:, None], scene.distractor_geoms, :3] = look.distractor_rgb
        return look.distractor_position

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
