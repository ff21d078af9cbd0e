"""Geom poses and colours go in; the camera's images come out."""

import copy
from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from knowarm.cores import available_cores
from knowarm.errors import UserError
from knowarm.world.config import EnvConfig
from knowarm.world.render import Raycaster
from knowarm.world.scene import Scene


class Renderer(Protocol):
    """Draws environments; the ray caster and MuJoCo's renderer look the same from outside."""

    def draw(
        self,
        geom_position: NDArray[np.float64],
        geom_matrix: NDArray[np.float64],
        geom_rgba: NDArray[np.float32],
        views: NDArray[np.float32] | None = None,
        lamps: NDArray[np.float32] | None = None,
    ) -> NDArray[np.uint8]:
        """Draw n images.

        Args:
            geom_position: (n, G, 3) [m], world.
            geom_matrix: (n, G, 9), rotation from geom to world.
            geom_rgba: (n, G, 4) in 0..1; alpha 0 hides a geom.
            views: position [m] and row-major rotation of each camera, (n, 12); None for the
                model's.
            lamps: sum of ambient colours, headlight's and sun's diffuse colours, direction
                towards the sun, (n, 4, 3); None for the model's.

        Returns:
            (n, H, W, 3) uint8 RGB, a new array.
        """


def make_renderer(scene: Scene, config: EnvConfig, size: int, num_threads: int = 0) -> Renderer:
    """Return the renderer the config asks for, drawing square images of a size [px].

    Args:
        scene: what is drawn.
        config: names the renderer.
        size: side of the images [px].
        num_threads: threads that share a batch, 0 for one a core; OpenGL takes one.
    """
    if config.renderer == "opengl":
        return OpenGLRenderer(scene, size)
    return RaycastRenderer(scene, size, config.antialiasing, num_threads)


class RaycastRenderer:
    """Our own ray caster: needs no OpenGL."""

    def __init__(self, scene: Scene, size: int, antialiasing: bool, num_threads: int) -> None:
        self._caster = Raycaster(
            scene.model,
            scene.camera,
            size,
            size,
            antialiasing=antialiasing,
            num_threads=num_threads or available_cores(),
        )
        self._size = size

    def draw(
        self,
        geom_position: NDArray[np.float64],
        geom_matrix: NDArray[np.float64],
        geom_rgba: NDArray[np.float32],
        views: NDArray[np.float32] | None = None,
        lamps: NDArray[np.float32] | None = None,
    ) -> NDArray[np.uint8]:
        """Draw n images; see ``Renderer.draw``."""
        out = np.empty((len(geom_position), self._size, self._size, 3), dtype=np.uint8)
        return self._caster.render(
            geom_position, geom_matrix, geom_rgba, out, views=views, lamps=lamps
        )


class OpenGLRenderer:
    """MuJoCo's own renderer without shadows and reflections: the reference, one by one and slow."""

    def __init__(self, scene: Scene, size: int) -> None:
        self._model = copy.copy(scene.model)
        self._model.vis.global_.offwidth = max(self._model.vis.global_.offwidth, size)
        self._model.vis.global_.offheight = max(self._model.vis.global_.offheight, size)
        # Materials would hide the colours set here, one environment after the other.
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
                self._light(lamps[i])
            self._renderer.update_scene(self._data, camera=self._camera)
            images.append(self._renderer.render())
        return np.stack(images)

    def _light(self, lamps: NDArray[np.float32]) -> None:
        """Set the headlight and the sun to lamps (4, 3)."""
        head = self._model.vis.headlight
        head.ambient[:], head.diffuse[:] = lamps[0], lamps[1]
        self._model.light_ambient[:] = 0
        self._model.light_diffuse[0] = lamps[2]
        self._data.light_xdir[0] = -lamps[3]
