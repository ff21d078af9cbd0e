"""Images of a scene with and without its parts, and the pixels in which they differ."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from mujoco import MjData
from PIL import Image

from knowarm.arrays import Floats32, Images, Integers, Mask
from knowarm.world.backend import MujocoSimulator
from knowarm.world.config import EnvConfig
from knowarm.world.render.renderer import make_renderer
from knowarm.world.scene.appearance import TargetColours, resting_colours
from knowarm.world.scene.compose import ROBOT_PREFIX
from knowarm.world.scene.scene import Scene

DIFFERENCE = 25
"""Change of a colour channel from which a pixel counts as showing the target, of 255."""


class SceneImages:
    """Draws a simulation's n copies of a scene as the policy sees them: (n, H, W, 3) each."""

    def __init__(
        self, scene: Scene, simulation: MujocoSimulator, config: EnvConfig
    ) -> None:
        self._scene = scene
        self._simulation = simulation
        self._renderer = make_renderer(scene, config, config.image_size)
        self._resting = resting_colours(scene, simulation.num_envs)
        self.empty = self._draw(self._resting)  # without targets

    def targets(self, targets: Sequence[int], colour: int = 0) -> Images:
        """Draw some of the targets, by index, each in its colour of an index."""
        visible = np.tile(targets, (self._simulation.num_envs, 1))
        paint = TargetColours(self._scene)
        return self._draw(paint(visible, np.full_like(visible, colour)))

    def robot_pixels(self) -> Integers:
        """Count the pixels that show the robot, (n,)."""
        colours = self._resting.copy()
        colours[:, robot_parts(self._scene), 3] = 0.0
        return different_pixels(self._draw(colours), self.empty)

    def _draw(self, colours: Floats32) -> Images:
        simulation = self._simulation
        return self._renderer.draw(
            simulation.geom_position, simulation.geom_matrix, colours
        )


def draw_once(
    scene: Scene,
    config: EnvConfig,
    data: MjData,
    colours: Floats32,
    side: int,
) -> Image.Image:
    """Draw one image of geoms in colours (1, G, 4), ``side`` pixels wide and high.

    Where it is larger than the policy's, full meshes are faster than simplifying them first.
    """
    if side > config.image_size:
        config = replace(config, mesh_detail="full")
    renderer = make_renderer(scene, config, side, 1)
    images = renderer.draw(data.geom_xpos[None], data.geom_xmat[None], colours)
    return Image.fromarray(images[0])


def different_pixels(a: Images, b: Images) -> Integers:
    """Count the pixels in which images (..., H, W, 3) differ, (...)."""
    change = np.abs(np.subtract(a, b, dtype=np.int16))
    is_different = change.max(axis=-1) > DIFFERENCE
    return is_different.sum(axis=(-2, -1))


def robot_parts(scene: Scene) -> Mask:
    """Return which geoms are the robot's, (G,): those of its file may have no names."""
    names = [scene.model.geom(g).name for g in range(scene.model.ngeom)]
    return np.array([not name or name.startswith(ROBOT_PREFIX) for name in names])


def fixed_parts(scene: Scene) -> Integers:
    """Return the geoms of the robot that no joint moves."""
    is_fixed = scene.model.body_weldid[scene.model.geom_bodyid] == 0
    return np.flatnonzero(robot_parts(scene) & is_fixed)
