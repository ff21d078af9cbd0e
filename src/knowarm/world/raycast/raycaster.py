"""A model and a camera go in; a ``Raycaster`` that turns geom poses into pictures comes out."""

from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from knowarm.errors import UserError
from knowarm.world.raycast.draw import LANES
from knowarm.world.raycast.numeric import FAR, Planes
from knowarm.world.raycast.render import render_range
from knowarm.world.raycast.tables import read_tables
from knowarm.world.raycast.trace import trace_planes

MAX_SIDE = 4096


class Trace(NamedTuple):
    """What the middle of each pixel shows."""

    geom: NDArray[np.int32]
    """Id of the geom that is seen, -1 for none, (n, H, W)."""

    distance: NDArray[np.float32]
    """Way from the eye along the pixel's ray [m], -1 for none, (n, H, W)."""

    normal: NDArray[np.float32]
    """Outward unit normal in the world, zero for none, (n, H, W, 3)."""


class Raycaster:
    """Draws the geoms of a model as seen by one of its cameras, without OpenGL.

    The same state gives the same bytes at any batch size and number of threads.

    Args:
        model: what to draw. Geoms welded to the world are drawn once and kept.
        camera: name or id of a perspective camera that stands still.
        width: width of the picture [px].
        height: height of the picture [px]; fovy spans it.
        num_threads: threads that share a batch.
        geom_groups: geom groups that are drawn; MuJoCo's renderer draws 0, 1 and 2.
        background: RGB where no geom is, 0 to 1.

    Attributes:
        geom_rgba: (G, 4) float32, colours as MuJoCo would draw them.

    Raises:
        UserError: a size is out of range, or the model holds what cannot be drawn.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        camera: int | str,
        width: int,
        height: int,
        *,
        num_threads: int = 1,
        geom_groups: tuple[int, ...] = (0, 1, 2),
        background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        for name, side in (("width", width), ("height", height)):
            if not 1 <= side <= MAX_SIDE:
                raise UserError(f"Raycaster {name} must lie in 1 to {MAX_SIDE}, got {side}.")
        if num_threads < 1:
            raise UserError(f"Raycaster num_threads must be at least 1, got {num_threads}.")
        self.width, self.height = width, height
        tables = read_tables(model, camera, geom_groups)
        self._tables = tables
        self._look = (tables.kind, tables.size, tables.glow)
        pixel = 2 * tables.half_height / height
        self._grid = (
            np.float32((1 - width) / 2 * pixel),
            np.float32((height - 1) / 2 * pixel),
            np.float32(pixel),
        )
        red, green, blue = (int(min(max(c, 0.0), 1.0) * 255 + 0.5) for c in background)
        self._background = np.int32(red | green << 8 | blue << 16)
        self._view, self._lamps = tables.camera[None], tables.lamps[None]
        self._planes = [self._empty_planes() for _ in range(num_threads)]
        self._positions = np.empty((0, 0, 3), dtype=np.float32)
        self._matrices = np.empty((0, 0, 9), dtype=np.float32)
        self._pool = ThreadPoolExecutor(num_threads) if num_threads > 1 else None
        # What stands still, drawn over nothing, is what every environment's picture begins with.
        self._cached = self._empty_planes()
        self._fixed, self._moving = tables.fixed[:0], tables.fixed
        standing = self._empty_planes()
        self._draw(0, 1, *self._poses(tables.position[None], tables.matrix[None]), None, standing)
        self._cached = standing
        self._fixed, self._moving = tables.fixed, tables.moving

    @property
    def geom_rgba(self) -> NDArray[np.float32]:
        """Colours of the model's geoms, (G, 4), to be changed and given back to ``render``."""
        return self._tables.rgba.copy()

    def render(
        self,
        geom_xpos: NDArray[Any],
        geom_xmat: NDArray[Any],
        geom_rgba: NDArray[np.float32] | None = None,
        out: NDArray[np.uint8] | None = None,
    ) -> NDArray[np.uint8]:
        """Draw a batch.

        Args:
            geom_xpos: (n, G, 3) positions [m], world, float32 or float64.
            geom_xmat: (n, G, 9) row-major rotations from geom to world.
            geom_rgba: (n, G, 4) colours, alpha 0 hides a geom and any other draws it opaque; None
                for the model's.
            out: (n, H, W, 3) to write into; None for a new array.

        Returns:
            (n, H, W, 3) uint8 RGB.
        """
        count = len(geom_xpos)
        if out is None:
            out = np.empty((count, self.height, self.width, 3), dtype=np.uint8)
        assert out.shape == (count, self.height, self.width, 3)
        assert out.flags.c_contiguous
        positions, matrices = self._poses(geom_xpos, geom_xmat)
        if self._pool is None or count == 1:
            self._draw(0, count, positions, matrices, geom_rgba, self._planes[0], out)
            return out
        threads = min(len(self._planes), count)
        cuts = [count * t // threads for t in range(threads + 1)]
        tasks = [
            self._pool.submit(
                self._draw,
                cuts[t],
                cuts[t + 1],
                positions,
                matrices,
                geom_rgba,
                self._planes[t],
                out,
            )
            for t in range(threads)
        ]
        for task in tasks:
            task.result()
        return out

    def trace(
        self,
        geom_xpos: NDArray[Any],
        geom_xmat: NDArray[Any],
        geom_rgba: NDArray[np.float32] | None = None,
    ) -> Trace:
        """Find what each pixel's middle shows, with the loops that draw; takes as ``render``."""
        positions, matrices = self._poses(geom_xpos, geom_xmat)
        shape = (len(positions), self.height, self.width)
        result = Trace(
            np.empty(shape, dtype=np.int32),
            np.empty(shape, dtype=np.float32),
            np.empty((*shape, 3), dtype=np.float32),
        )
        planes = self._planes[0]
        for e in range(len(positions)):
            self._draw(e, e + 1, positions, matrices, geom_rgba, planes)
            trace_planes(
                planes, positions[e], matrices[e], self._view[0], self._look, self._grid,
                result.geom[e], result.distance[e], result.normal[e],
            )  # fmt: skip
        return result

    def _draw(
        self,
        start: int,
        stop: int,
        positions: NDArray[np.float32],
        matrices: NDArray[np.float32],
        geom_rgba: NDArray[np.float32] | None,
        planes: Planes,
        out: NDArray[np.uint8] | None = None,
    ) -> None:
        """Draw environments start .. stop - 1; without ``out`` only the last one's planes."""
        rgba = self._tables.rgba[None] if geom_rgba is None else geom_rgba
        assert rgba.shape[1:] == self._tables.rgba.shape
        assert len(rgba) in (1, len(positions))
        render_range(
            start, stop, positions, matrices, np.ascontiguousarray(rgba, dtype=np.float32),
            self._view, self._lamps, self._look, self._fixed, self._moving, self._tables.rgba,
            self._cached, self._grid, self._background, planes,
            np.empty((stop, 0, 0, 3), dtype=np.uint8) if out is None else out,
        )  # fmt: skip

    def _poses(
        self, geom_xpos: NDArray[Any], geom_xmat: NDArray[Any]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Copy poses into kept float32 arrays: both devices compute from the same numbers."""
        count, geoms = len(geom_xpos), len(self._tables.kind)
        assert geom_xpos.shape == (count, geoms, 3), geom_xpos.shape
        assert geom_xmat.shape == (count, geoms, 9), geom_xmat.shape
        if len(self._positions) < count:
            self._positions = np.empty((count, geoms, 3), dtype=np.float32)
            self._matrices = np.empty((count, geoms, 9), dtype=np.float32)
        positions, matrices = self._positions[:count], self._matrices[:count]
        np.copyto(positions, geom_xpos, casting="same_kind")
        np.copyto(matrices, geom_xmat, casting="same_kind")
        return positions, matrices

    def _empty_planes(self) -> Planes:
        """Depth, owner and colour planes of nothing, rows padded to whole blocks."""
        shape = (self.height, -(-self.width // LANES) * LANES)
        return (
            np.full(shape, FAR, dtype=np.float32),
            np.full(shape, -1, dtype=np.int32),
            np.full(shape, self._background, dtype=np.int32),
        )
