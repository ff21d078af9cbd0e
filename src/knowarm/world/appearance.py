"""Targets and colours of episodes go in; the colour of every geom comes out."""

import numpy as np
from numpy.typing import NDArray

from knowarm.world.scene import Scene


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
