"""CUDA ray caster: images of MuJoCo geoms on an NVIDIA GPU, without copies to the host."""

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from knowarm.errors import UserError
from knowarm.private_apis import no_fused_multiply_add
from knowarm.world.render.cpu import Raycaster
from knowarm.world.render.cuda_kernels import (
    ACROSS,
    DOWN,
    WORD,
    Array,
    cuda,
    draw_kernel,
    fill_kernel,
    mask_kernel,
    project_kernel,
)
from knowarm.world.render.tiles import BITS, EXTENT, RECORD, Grid

THREADS = 128
"""Threads per block."""


class CudaRaycaster:
    """Ray caster on the GPU; draws the same bytes as a ``Raycaster`` with the same arguments.

    Arrays of any library that offers ``__cuda_array_interface__`` (torch, Warp, Numba) are read
    and written in place.

    Args:
        model: as for ``Raycaster``.
        camera: as for ``Raycaster``.
        width: as for ``Raycaster``.
        height: as for ``Raycaster``.
        **options: as for ``Raycaster``, without ``num_threads``.

    Raises:
        UserError: there is no CUDA device, or as for ``Raycaster``.
    """

    def __init__(
        self, model: mujoco.MjModel, camera: int | str, width: int, height: int, **options: Any
    ) -> None:
        if not cuda.is_available():
            raise UserError(
                "The GPU ray caster found no CUDA device; draw on the CPU (device 'cpu'), or "
                "install an NVIDIA driver and `pip install numba-cuda[cu12]`."
            )
        host = Raycaster(model, camera, width, height, **options)
        scenery, meshes = host.scenery, host.scenery.meshes
        self._height, self._width, self._grid = height, width, host.grid
        self._threads = -(-height // DOWN) * -(-width // ACROSS) * DOWN * ACROSS
        self._fixed = len(scenery.fixed)
        self._background = int(host.stored.empty[1][0])
        self._order = cuda.to_device(np.concatenate([scenery.fixed, scenery.moving]))
        self._shape = _on_device(
            scenery.kind, scenery.size, scenery.emission, meshes.middle, meshes.half
        )
        self._triangles = _on_device(meshes.vertex, meshes.face, meshes.normal, meshes.span)
        self._backdrop = _on_device(*host.stored.backdrop)
        self._rgba, self._own_rgba, self._view, self._lamps = _on_device(
            scenery.rgba, scenery.rgba[None], host.view[None], host.lamps.reshape(1, 12)
        )
        self._all = cuda.to_device(np.ones(1, dtype=np.bool_))
        self._lines, self._words = mask_shape(host.grid, len(self._order))
        none = cuda.device_array((0,), dtype=np.int32)
        self._record = self._extent = self._redraw = self._masks = none

    def draw(
        self,
        geom_position: Array,
        geom_matrix: Array,
        geom_rgba: Array | None = None,
        views: Array | None = None,
        lamps: Array | None = None,
        *,
        out: Array | None = None,
        wanted: Array | None = None,
        stream: Any = 0,
    ) -> Array:
        """Draw n images.

        Args:
            geom_position: (n, G, 3) [m], world, float32 or float64.
            geom_matrix: (n, G, 9), row-major rotation from geom to world.
            geom_rgba: (n, G, 4) float32 in 0..1; alpha 0 hides a geom; None for the model's.
            views: (n, 12) float32 cameras, as ``Raycaster.view``; None for the model's.
            lamps: (n, 4, 3) float32 lights, as ``Raycaster.lamps``; None for the model's.
            out: (n, H, W, 3) uint8 to write; None for a new Numba device array.
            wanted: (n,) bool, the environments to draw; the images of the others keep their
                values. None draws all.
            stream: the Numba stream to launch on, 0 for the default one.

        Returns:
            ``out``. Launches are asynchronous, in the stream's order.
        """
        count, slots = len(geom_position), len(self._order)
        if len(self._redraw) < count:
            self._record = cuda.device_array((count, slots, RECORD), dtype=np.float32)
            self._extent = cuda.device_array((count, slots, EXTENT), dtype=np.int32)
            self._redraw = cuda.device_array((count,), dtype=np.int32)
            self._masks = cuda.device_array((count, self._lines, self._words), dtype=np.uint64)
        if out is None:
            shape = (count, self._height, self._width, 3)
            out = cuda.device_array(shape, dtype=np.uint8)
        shared = views is None and lamps is None
        record, extent, redraw = self._record[:count], self._extent[:count], self._redraw[:count]
        masks, strips = self._masks[:count], self._grid.strips
        drawn = self._all if wanted is None else _adopt(wanted)
        with no_fused_multiply_add():
            fill_kernel[_blocks(count), THREADS, stream](redraw, 0 if shared else 1)
            project_kernel[_blocks(count * slots), THREADS, stream](
                self._order, self._fixed, self._shape, self._rgba, _adopt(geom_position),
                _adopt(geom_matrix), self._own_rgba if geom_rgba is None else _adopt(geom_rgba),
                self._view if views is None else _adopt(views),
                self._lamps if lamps is None else _adopt(lamps).reshape(count, 12),
                self._grid, record, extent, redraw, drawn,
            )  # fmt: skip
            mask_kernel[_blocks(count * self._lines * self._words), THREADS, stream](
                extent, self._fixed, redraw, strips, drawn, masks
            )
            draw_kernel[_blocks(count * self._threads), THREADS, stream](
                record, extent, masks, redraw, self._grid, self._backdrop,
                self._background, self._triangles, drawn, _adopt(out),
            )  # fmt: skip
        return out


def mask_shape(grid: Grid, geoms: int) -> tuple[int, int]:
    """Return the columns and rows of tiles together, and the words that hold a bit per geom."""
    return int(grid.strips) + (int(grid.rows) >> BITS), max(1, -(-geoms // WORD))


def _blocks(threads: int) -> int:
    return -(-threads // THREADS)


def _on_device(*arrays: NDArray[Any]) -> tuple[Array, ...]:
    return tuple(cuda.to_device(np.ascontiguousarray(array)) for array in arrays)


def _adopt(array: Array) -> Array:
    """View a foreign device array as Numba's, without a copy or a wait for its stream."""
    foreign = hasattr(array, "__cuda_array_interface__") and hasattr(cuda, "as_cuda_array")
    return cuda.as_cuda_array(array, sync=False) if foreign else array
