"""Renderer interface, and the choice of renderer.

Two implementations: the ray caster (``cpu.Raycaster``, compiled by Numba), and MuJoCo's OpenGL
renderer as the reference (``OpenGLRenderer``).
"""

import copy
from typing import Protocol

import mujoco
import numpy as np

from knowarm.arrays import Floats, Floats32, Images
from knowarm.cores import available_cores
from knowarm.errors import UserError
from knowarm.world.config import EnvConfig
from knowarm.world.rebuilt import Rebuilt
from knowarm.world.render.cpu import Raycaster
from knowarm.world.scene.scene import Scene


class Renderer(Protocol):
    """Draws the environments of a batch from the poses of their geoms."""

    def draw(
        self,
        geom_position: Floats,
        geom_matrix: Floats,
        geom_rgba: Floats32,
        views: Floats32 | None = None,
        lamps: Floats32 | None = None,
    ) -> Images:
        """Draw n images.

        Args:
            geom_position: (n, G, 3) [m], world.
            geom_matrix: (n, G, 9), row-major rotation from geom to world.
            geom_rgba: (n, G, 4) in 0..1; alpha 0 hides a geom.
            views: position [m] and row-major rotation of each camera, (n, 12); None for the
                model's.
            lamps: sum of ambient colours, diffuse colours of headlight and directional light, and
                the unit vector towards the latter, (n, 4, 3); None for the model's.

        Returns:
            (n, H, W, 3) uint8 RGB, a new array.
        """


MESH_TRIANGLE_PX = 0.71  # Size of the triangles of simplified meshes [px]


def make_renderer(
    scene: Scene, config: EnvConfig, size: int, num_threads: int = 0
) -> Renderer:
    """Construct the renderer that a config names, for square images of ``size`` pixels.

    ``num_threads`` share a batch, 0 for one per core; OpenGL uses one.
    """
    if config.renderer == "opengl":
        return OpenGLRenderer(scene, size)
    return Raycaster(
        scene.model,
        scene.camera,
        size,
        size,
        antialiasing=config.antialiasing,
        num_threads=num_threads or available_cores(),
        mesh_triangle_px=MESH_TRIANGLE_PX if config.mesh_detail == "pixels" else None,
    )


class OpenGLRenderer(Rebuilt):
    """MuJoCo's renderer without shadows and reflections; slow, because it draws one by one."""

    def __init__(self, scene: Scene, size: int) -> None:
        model = copy.copy(scene.model)
        buffer = model.vis.global_
        buffer.offwidth = max(buffer.offwidth, size)
        buffer.offheight = max(buffer.offheight, size)
        # Materials would hide the colours that are set per environment.
        model.geom_matid[:] = -1
        self._model = model
        self._camera = scene.camera
        self._data = mujoco.MjData(model)
        try:
            self._renderer = mujoco.Renderer(model, size, size)
        except Exception as error:
            raise UserError(
                f"EnvConfig.renderer 'opengl' found no OpenGL on this machine ({error}). Install "
                "OSMesa (libosmesa6) and set MUJOCO_GL=osmesa, or use renderer 'raycast', which "
                "needs none."
            ) from error
        flags = self._renderer.scene.flags
        flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
        flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
        mujoco.mj_forward(model, self._data)

    def draw(
        self,
        geom_position: Floats,
        geom_matrix: Floats,
        geom_rgba: Floats32,
        views: Floats32 | None = None,
        lamps: Floats32 | None = None,
    ) -> Images:
        """Draw n images; see ``Renderer.draw``."""
        model = self._model
        data = self._data
        images = []
        for i in range(len(geom_position)):
            data.geom_xpos[:] = geom_position[i]
            data.geom_xmat[:] = geom_matrix[i]
            model.geom_rgba[:] = geom_rgba[i]
            if views is not None:
                data.cam_xpos[self._camera] = views[i, :3]
                data.cam_xmat[self._camera] = views[i, 3:]
            if lamps is not None:
                ambient, head, sun, towards_sun = lamps[i]
                headlight = model.vis.headlight
                headlight.ambient[:] = ambient
                headlight.diffuse[:] = head
                model.light_ambient[:] = 0
                model.light_diffuse[0] = sun
                data.light_xdir[0] = -towards_sun
            self._renderer.update_scene(data, camera=self._camera)
            images.append(self._renderer.render())
        return np.stack(images)
