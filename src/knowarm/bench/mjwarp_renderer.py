"""Geom poses and colours go in; images by MuJoCo Warp's ray caster on its CPU device come out."""

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from knowarm.errors import UserError
from knowarm.world.scene import Scene

FAR_BELOW_M = -100.0
"""Where hidden geoms are put [m]: MuJoCo Warp draws a geom whatever its alpha."""


class MjWarpRenderer:
    """The competitor's renderer behind the interface of ``knowarm.world.render.renderer``.

    Shadows, specular highlights and emission are off, as in ours. Warp keeps the model's colours:
    the target's colour is not randomized here, which costs it nothing.

    Args:
        scene: what is drawn.
        size: side of the images [px].
        num_envs: n, fixed.

    Raises:
        UserError: MuJoCo Warp is not installed.
    """

    def __init__(self, scene: Scene, size: int, num_envs: int) -> None:
        try:
            import mujoco_warp
            import warp
        except ImportError as error:
            raise UserError(
                f"This row needs MuJoCo Warp ({error}): pip install mujoco-warp warp-lang, or "
                "leave it out with --no-mjwarp."
            ) from None
        warp.config.log_level = warp.LOG_WARNING
        self._mjw: Any = mujoco_warp
        self._warp: Any = warp
        self._size, self._count = size, num_envs
        self._device = warp.ScopedDevice("cpu")
        data = mujoco.MjData(scene.model)
        mujoco.mj_forward(scene.model, data)
        with self._device:
            self._model = mujoco_warp.put_model(scene.model)
            self._data = mujoco_warp.put_data(scene.model, data, nworld=num_envs)
            mujoco_warp.kinematics(self._model, self._data)
            mujoco_warp.camlight(self._model, self._data)
            self._context = mujoco_warp.create_render_context(
                scene.model,
                nworld=num_envs,
                cam_res=(size, size),
                render_rgb=True,
                use_shadows=False,
                enable_specular=False,
                enable_emission=False,
            )
        # Arrays of the CPU device and NumPy's views of them share their memory.
        self._position = self._data.geom_xpos.numpy()
        self._matrix = self._data.geom_xmat.numpy().reshape(num_envs, -1, 9)
        self._packed = self._context.rgb_data.numpy()

    def draw(
        self,
        geom_position: NDArray[np.float64],
        geom_matrix: NDArray[np.float64],
        geom_rgba: NDArray[np.float32],
        views: NDArray[np.float32] | None = None,
        lamps: NDArray[np.float32] | None = None,
    ) -> NDArray[np.uint8]:
        """Draw at most n images; see ``knowarm.world.render.renderer.Renderer.draw``."""
        assert views is None
        assert lamps is None
        count = len(geom_position)
        self._position[:count] = geom_position
        self._matrix[:count] = geom_matrix
        self._position[:count, :, 2][geom_rgba[..., 3] == 0] = FAR_BELOW_M
        with self._device:
            self._mjw.refit_bvh(self._model, self._data, self._context)
            self._mjw.render(self._model, self._data, self._context)
        packed = self._packed[:count].reshape(count, self._size, self._size)
        return np.stack([packed >> 16 & 255, packed >> 8 & 255, packed & 255], axis=-1).astype(
            np.uint8
        )
