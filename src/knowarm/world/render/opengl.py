"""OpenGL renderer: MuJoCo's own renderer, the reference for the ray caster's images."""

import copy

import mujoco
import numpy as np
from numpy.typing import NDArray

from knowarm.errors import UserError
from knowarm.world.scene.scene import Scene


class OpenGLRenderer:
    """MuJoCo's renderer without shadows and reflections; slow, because it draws one by one."""

    def __init__(self, scene: Scene, size: int) -> None:
        self._model = copy.copy(scene.model)
        self._model.vis.global_.offwidth = max(self._model.vis.global_.offwidth, size)
        self._model.vis.global_.offheight = max(self._model.vis.global_.offheight, size)
        # Materials would hide the colours that are set per environment.
        self._model.geom_matid[:] = -1
        self._camera = scene.camera
        self._data = mujoco.MjData(self._model)
        try:
            self._renderer = mujoco.Renderer(self._model, size, size)
        except Exception as error:
            raise UserError(
                f"EnvConfig.renderer 'opengl' found no OpenGL on this machine ({error}). Install "
                "OSMesa (libosmesa6) and set MUJOCO_GL=osmesa, or use renderer 'raycast', which "
                "needs none."
            ) from error
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            self._renderer.scene.flags[flag] = 0
        mujoco.mj_forward(self._model, self._data)

    def draw(
        self,
        geom_position: NDArray[np.float64],
        geom_matrix: NDArray[np.float64],
        geom_rgba: NDArray[np.float32],
        views: NDArray[np.float32] | None = None,
        lamps: NDArray[np.float32] | None = None,
    ) -> NDArray[np.uint8]:
        """Draw n images; see ``Renderer.draw``."""
        images = []
        for i in range(len(geom_position)):
            self._data.geom_xpos[:] = geom_position[i]
            self._data.geom_xmat[:] = geom_matrix[i]
            self._model.geom_rgba[:] = geom_rgba[i]
            if views is not None:
                self._data.cam_xpos[self._camera] = views[i, :3]
                self._data.cam_xmat[self._camera] = views[i, 3:]
            if lamps is not None:
                self._set_lights(lamps[i])
            self._renderer.update_scene(self._data, camera=self._camera)
            images.append(self._renderer.render())
        return np.stack(images)

    def _set_lights(self, lamps: NDArray[np.float32]) -> None:
        """Set headlight and directional light from lamps (4, 3)."""
        head = self._model.vis.headlight
        head.ambient[:], head.diffuse[:] = lamps[0], lamps[1]
        self._model.light_ambient[:] = 0
        self._model.light_diffuse[0] = lamps[2]
        self._data.light_xdir[0] = -lamps[3]
