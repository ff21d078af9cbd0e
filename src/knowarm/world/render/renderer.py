"""Renderer interface, for NumPy arrays and for torch tensors, and the choice of renderer.

Three implementations: the ray caster on the CPU (``cpu.Raycaster``, compiled by Numba), the same
ray caster on an NVIDIA GPU (``cuda.CudaRaycaster``), and MuJoCo's OpenGL renderer as the reference
(``opengl.OpenGLRenderer``).
"""

from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from knowarm.cores import available_cores
from knowarm.errors import UserError
from knowarm.world.config import EnvConfig
from knowarm.world.render.cpu import Raycaster
from knowarm.world.scene import Scene

if TYPE_CHECKING:
    import torch
    from torch import Tensor

    from knowarm.world.render.cuda import CudaRaycaster


class Renderer(Protocol):
    """Draws the environments of a batch from the poses of their geoms, NumPy arrays."""

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
            geom_matrix: (n, G, 9), row-major rotation from geom to world.
            geom_rgba: (n, G, 4) in 0..1; alpha 0 hides a geom.
            views: position [m] and row-major rotation of each camera, (n, 12); None for the
                model's.
            lamps: sum of ambient colours, diffuse colours of headlight and directional light, and
                the unit vector towards the latter, (n, 4, 3); None for the model's.

        Returns:
            (n, H, W, 3) uint8 RGB, a new array.
        """


MESH_ERROR_PX = 0.4
"""How far the outline of a simplified mesh may be moved [px]."""


def mesh_error(config: EnvConfig) -> float | None:
    """Return the allowed error of meshes [px], or None to draw all their triangles."""
    return MESH_ERROR_PX if config.mesh_detail == "pixels" else None


def make_renderer(scene: Scene, config: EnvConfig, size: int, num_threads: int = 0) -> Renderer:
    """Construct the renderer that a config names.

    Args:
        scene: what is drawn.
        config: names the renderer and whether it uses anti-aliasing.
        size: side of the square images [px].
        num_threads: threads that share a batch, 0 for one per core; OpenGL uses one.

    Raises:
        UserError: the config names OpenGL and this machine has none.
    """
    if config.renderer == "opengl":
        from knowarm.world.render.opengl import OpenGLRenderer

        return OpenGLRenderer(scene, size)
    return Raycaster(
        scene.model,
        scene.camera,
        size,
        size,
        antialiasing=config.antialiasing,
        num_threads=num_threads or available_cores(),
        mesh_error_px=mesh_error(config),
    )


class TorchRenderer:
    """The ray caster for tensors: on the CPU, or by CUDA kernels on torch's current stream.

    Args:
        scene: what is drawn.
        config: side and anti-aliasing of the images.
        device: device of all tensors.

    Raises:
        UserError: the config names OpenGL, or the ray caster does not run on this GPU.
    """

    def __init__(self, scene: Scene, config: EnvConfig, device: "torch.device") -> None:
        if config.renderer == "opengl":
            raise UserError(
                "EnvConfig.renderer 'opengl' draws on the CPU, one image at a time; environments "
                "on a device draw with renderer 'raycast' only. Leave out device for OpenGL."
            )
        self._device, self._raycaster = device, None
        if device.type == "cuda":
            self._raycaster = _make_cuda_raycaster(scene, config, device)
        else:
            self._renderer = make_renderer(scene, config, config.image_size)

    def draw(
        self,
        geom_position: "Tensor",
        geom_matrix: "Tensor",
        geom_rgba: "Tensor",
        views: "Tensor | None" = None,
        lamps: "Tensor | None" = None,
        *,
        out: "Tensor",
        wanted: "Tensor | None" = None,
    ) -> "Tensor":
        """Draw n images.

        Args:
            geom_position: as for ``Renderer.draw``, float32.
            geom_matrix: as for ``Renderer.draw``, float32.
            geom_rgba: as for ``Renderer.draw``.
            views: as for ``Renderer.draw``.
            lamps: as for ``Renderer.draw``.
            out: (n, H, W, 3) uint8, contiguous, to write.
            wanted: (n,) bool, the environments to draw; the images of the others keep their
                values. None draws all.

        Returns:
            ``out``; on a GPU it is written in the order of torch's current stream.
        """
        given = (geom_position, geom_matrix, geom_rgba, views, lamps)
        if self._raycaster is None:
            rows: Any = slice(None) if wanted is None else np.flatnonzero(wanted.numpy())
            arrays: Any = [None if tensor is None else tensor.numpy()[rows] for tensor in given]
            if len(arrays[0]):
                out.numpy()[rows] = self._renderer.draw(*arrays)
            return out
        import torch
        from numba import cuda

        handle = torch.cuda.current_stream(self._device).cuda_stream
        stream = cuda.external_stream(handle) if handle else 0
        self._raycaster.draw(*given, out=out, wanted=wanted, stream=stream)
        return out


def _make_cuda_raycaster(
    scene: Scene, config: EnvConfig, device: "torch.device"
) -> "CudaRaycaster":
    """Construct the CUDA ray caster and compile its kernels by drawing one image."""
    import torch

    # Imported here because numba.cuda loads slowly and searches for a driver.
    from knowarm.world.render.cuda import CudaRaycaster

    size = config.image_size
    raycaster = CudaRaycaster(
        scene.model,
        scene.camera,
        size,
        size,
        antialiasing=config.antialiasing,
        mesh_error_px=mesh_error(config),
    )
    poses = [torch.zeros((1, scene.model.ngeom, k), device=device) for k in (3, 9)]
    try:
        raycaster.draw(*poses)
        torch.cuda.synchronize(device)
    except Exception as error:  # of Numba, NVVM, the linker or the driver
        raise UserError(
            f"Numba could not compile or run the ray caster on the GPU ({error}). Its CUDA "
            f"must match the driver's and torch's ({torch.version.cuda}): pip install "
            "'knowarm[gpu]' and numba-cuda[cu12] or numba-cuda[cu13], or use the CPU."
        ) from error
    return raycaster


def make_torch_renderer(scene: Scene, config: EnvConfig, device: "torch.device") -> TorchRenderer:
    """Construct the renderer for tensors on a device; see ``TorchRenderer``."""
    return TorchRenderer(scene, config, device)
