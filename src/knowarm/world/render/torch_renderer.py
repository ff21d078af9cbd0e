"""Poses on a device and looks go in; the camera's images come out on the same device."""

from typing import Any, Protocol

import torch
from torch import Tensor

from knowarm.errors import UserError
from knowarm.world.appearance import Shown
from knowarm.world.backends.device import INSTALL
from knowarm.world.backends.warp import WarpSimulator
from knowarm.world.config import EnvConfig
from knowarm.world.render.renderer import make_renderer
from knowarm.world.scene import Scene


class TorchRenderer(Protocol):
    """Draws environments from a simulation's poses where they lie."""

    def draw(self, simulation: WarpSimulator, shown: Shown, out: Tensor, wanted: Any) -> None:
        """Draw images.

        Args:
            simulation: whose geoms are drawn.
            shown: how the n environments look.
            out: (n, H, W, 3) uint8, contiguous, to write into.
            wanted: (n,) bool tensor, the environments to draw; the others' images are left as
                they are. None draws all.
        """


def make_torch_renderer(scene: Scene, config: EnvConfig, device: torch.device) -> TorchRenderer:
    """Return what draws the observations on a device.

    Args:
        scene: what is drawn.
        config: side and anti-aliasing of the images.
        device: where the poses lie.

    Raises:
        UserError: the config asks for OpenGL.
    """
    if config.renderer == "opengl":
        raise UserError(
            "EnvConfig.renderer 'opengl' draws on the CPU, one image after the other; the device "
            "environment draws with renderer 'raycast' only. Leave out device for OpenGL."
        )
    if device.type == "cuda":
        return CudaRenderer(scene, config, device)
    return HostRenderer(scene, config)


class HostRenderer:
    """The CPU's ray caster over tensors of the CPU."""

    def __init__(self, scene: Scene, config: EnvConfig) -> None:
        self._renderer = make_renderer(scene, config, config.image_size)

    def draw(self, simulation: WarpSimulator, shown: Shown, out: Tensor, wanted: Any) -> None:
        """Draw images; see ``TorchRenderer.draw``."""
        ids: Any = slice(None) if wanted is None else wanted.nonzero()[:, 0]
        positions = simulation.geom_position[ids].numpy()
        if not len(positions):
            return
        rgba: Any
        rgba, views, lamps = (None if look is None else look[ids].numpy() for look in shown[:3])
        images = self._renderer.draw(
            positions, simulation.geom_matrix[ids].numpy(), rgba, views, lamps
        )
        out[ids] = torch.from_numpy(images)


class CudaRenderer:
    """The ray caster's kernels, launched by Numba on torch's current stream."""

    def __init__(self, scene: Scene, config: EnvConfig, device: torch.device) -> None:
        # Numba's CUDA half is imported where it is used: it takes a while and looks for a driver.
        from numba import cuda

        from knowarm.world.render.cuda import CudaRaycaster

        self._cuda: Any = cuda
        self._device = device
        self._caster = CudaRaycaster(
            scene.model,
            scene.camera,
            config.image_size,
            config.image_size,
            antialiasing=config.antialiasing,
        )
        self._compile(scene.model.ngeom)

    def _compile(self, geoms: int) -> None:
        """Draw one image, which compiles the kernels.

        Raises:
            UserError: they do not compile or run with what is installed.
        """
        poses = [torch.zeros((1, geoms, k), device=self._device) for k in (3, 9)]
        try:
            self._caster.render(*poses)
            torch.cuda.synchronize(self._device)
        except Exception as error:  # of Numba, NVVM, the linker or the driver
            raise UserError(
                f"Numba could not compile or run the ray caster on the GPU ({error}). Its CUDA "
                f"must be the driver's and torch's ({torch.version.cuda}): {INSTALL}, and with it "
                "numba-cuda[cu12] or numba-cuda[cu13]; or use the CPU."
            ) from error

    def draw(self, simulation: WarpSimulator, shown: Shown, out: Tensor, wanted: Any) -> None:
        """Draw images; see ``TorchRenderer.draw``."""
        handle = torch.cuda.current_stream(self._device).cuda_stream
        self._caster.render(
            simulation.geom_position,
            simulation.geom_matrix,
            shown.rgba,
            out,
            views=shown.views,
            lamps=None if shown.lamps is None else shown.lamps.reshape(-1, 12),
            wanted=wanted,
            stream=self._cuda.external_stream(handle) if handle else 0,
        )
