"""A model and a camera go in; a ``Raycaster`` that turns geom poses into images comes out."""

from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from knowarm.errors import UserError
from knowarm.world.render.fill import Field
from knowarm.world.render.fill_mesh import PROJECTION
from knowarm.world.render.grid import ANTIALIASING, TILE, Grid, make_grid
from knowarm.world.render.meshes import read_meshes
from knowarm.world.render.numeric import FAR
from knowarm.world.render.prepare import EXTENT, RECORD
from knowarm.world.render.render import Scenery, Scratch, render_range
from knowarm.world.render.tables import read_tables
from knowarm.world.render.trace import trace_field

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
        width: width of the image [px].
        height: height of the image [px]; fovy spans it.
        antialiasing: four rays a pixel in a rotated grid instead of one through its middle.
        num_threads: threads that share a batch.
        geom_groups: geom groups that are drawn; MuJoCo's renderer draws 0, 1 and 2.
        background: RGB where no geom is, 0 to 1.

    Attributes:
        view: (12,) float32, position [m] and row-major rotation of the camera in the world.
        grid: where the samples lie.
        scenery: what all environments share.
        lamps: (4, 3) float32: sum of ambient colours, diffuse colours of headlight and directional
            light, and the unit vector towards the latter, world.

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
        antialiasing: bool = False,
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
        self.grid = make_grid(
            width, height, tables.half_height, ANTIALIASING if antialiasing else 1
        )
        self.view, self.lamps = tables.camera, tables.lamps
        self._pool = ThreadPoolExecutor(num_threads) if num_threads > 1 else None
        self._positions = np.empty((0, 0, 3), dtype=np.float32)
        self._matrices = np.empty((0, 0, 9), dtype=np.float32)

        rgb = [int(min(max(channel, 0.0), 1.0) * 255 + 0.5) for channel in background]
        packed = rgb[0] | rgb[1] << 8 | rgb[2] << 16
        empty = _make_field(self.grid, packed)
        meshes = read_meshes(model)
        largest = int((meshes.span[:, 1] - meshes.span[:, 0]).max(initial=0))
        self._scratch = [
            _make_scratch(self.grid, len(tables.kind), largest) for _ in range(num_threads)
        ]
        nothing = np.tile(np.array(rgb, dtype=np.uint8), height * width)
        self.scenery = Scenery(
            tables.kind, tables.size, tables.glow, meshes, tables.rgba, tables.fixed, tables.moving,
            empty=empty, backdrop=empty, nothing=nothing, image=nothing,
        )  # fmt: skip
        self._keep_fixed()

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
        *,
        views: NDArray[np.float32] | None = None,
        lamps: NDArray[np.float32] | None = None,
    ) -> NDArray[np.uint8]:
        """Draw a batch.

        Args:
            geom_xpos: (n, G, 3) positions [m], world, float32 or float64.
            geom_xmat: (n, G, 9) row-major rotations from geom to world.
            geom_rgba: (n, G, 4) colours, alpha 0 hides a geom and any other draws it opaque; None
                for the model's.
            out: (n, H, W, 3) to write into; None for a new array.
            views: (n, 12) a camera for each environment, as ``view``; None for the model's.
            lamps: (n, 4, 3) lights for each environment, as ``lamps``; None for the model's. With
                either, the geoms that stand still are drawn anew in every image.

        Returns:
            (n, H, W, 3) uint8 RGB.
        """
        count = len(geom_xpos)
        if out is None:
            out = np.empty((count, self.height, self.width, 3), dtype=np.uint8)
        assert out.shape == (count, self.height, self.width, 3)
        assert out.flags.c_contiguous
        poses = self._poses(geom_xpos, geom_xmat)
        seen = self._appearance(count, geom_rgba, views, lamps)
        if self._pool is None or count == 1:
            self._draw(0, count, poses, seen, 0, out)
            return out
        threads = min(len(self._scratch), count)
        cuts = [count * t // threads for t in range(threads + 1)]
        tasks = [
            self._pool.submit(self._draw, cuts[t], cuts[t + 1], poses, seen, t, out)
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
        """Find what each pixel's middle shows, with the loops that draw; takes as ``render``.

        Raises:
            UserError: the ray caster anti-aliases.
        """
        if self.grid.mask:
            raise UserError(
                "Raycaster.trace needs antialiasing=False, as several rays of a pixel can show "
                "several geoms; make another Raycaster for it."
            )
        positions, matrices = poses = self._poses(geom_xpos, geom_xmat)
        seen = self._appearance(len(positions), geom_rgba, None, None)
        shape = (len(positions), self.height, self.width)
        result = Trace(
            np.empty(shape, dtype=np.int32),
            np.empty(shape, dtype=np.float32),
            np.empty((*shape, 3), dtype=np.float32),
        )
        for e in range(len(positions)):
            self._draw(e, e + 1, poses, seen, 0, None)
            trace_field(
                self._scratch[0].field, positions[e], matrices[e], self.view, self.scenery,
                self.grid, result.geom[e], result.distance[e], result.normal[e],
            )  # fmt: skip
        return result

    def _keep_fixed(self) -> None:
        """Draw what stands still: samples and image that every environment begins with."""
        tables, scenery = self._tables, self.scenery
        image = np.empty((1, self.height, self.width, 3), dtype=np.uint8)
        self.scenery = scenery._replace(fixed=tables.fixed[:0], moving=tables.fixed)
        poses = self._poses(tables.position[None], tables.matrix[None])
        self._draw(0, 1, poses, self._appearance(1, None, None, None), 0, image)
        # Only the tiles that were touched are in the scratch field.
        drawn, kept = self._scratch[0].field, (scenery.empty[0].copy(), scenery.empty[1].copy())
        for strip, dirty in enumerate(self._scratch[0].dirty):
            first, last = (strip * self.grid.rows + dirty) * TILE
            for to, of in zip(kept, drawn, strict=True):
                to[first:last] = of[first:last]
        self.scenery = scenery._replace(backdrop=kept, image=image.reshape(-1))

    def _draw(
        self,
        start: int,
        stop: int,
        poses: tuple[NDArray[np.float32], NDArray[np.float32]],
        seen: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]],
        thread: int,
        out: NDArray[np.uint8] | None,
    ) -> None:
        """Draw environments start .. stop - 1; without ``out``, leave geom ids in the scratch."""
        render_range(
            start, stop, *poses, *seen, self.grid, self.scenery, self._scratch[thread],
            out is None, np.empty((0, 0, 0, 3), dtype=np.uint8) if out is None else out,
        )  # fmt: skip

    def _appearance(
        self,
        count: int,
        geom_rgba: NDArray[np.float32] | None,
        views: NDArray[np.float32] | None,
        lamps: NDArray[np.float32] | None,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
        """Colours, cameras and lights: one for all environments, or one for each."""
        result = []
        for given, own in ((geom_rgba, self._tables.rgba), (views, self.view), (lamps, self.lamps)):
            assert given is None or given.shape == (count, *own.shape), given.shape
            values = own[None] if given is None else given
            result.append(np.ascontiguousarray(values, dtype=np.float32))
        return result[0], result[1], result[2].reshape(-1, 12)

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


def _make_field(grid: Grid, value: int) -> Field:
    count = grid.strips * grid.rows * TILE
    return np.full(count, FAR, dtype=np.float32), np.full(count, value, dtype=np.int32)


def _make_scratch(grid: Grid, geoms: int, vertices: int) -> Scratch:
    return Scratch(
        field=_make_field(grid, 0),
        record=np.empty((geoms, RECORD), dtype=np.float32),
        extent=np.empty((geoms, EXTENT), dtype=np.int32),
        projection=np.empty((PROJECTION, vertices), dtype=np.float32),
        dirty=np.empty((grid.strips, 2), dtype=np.int32),
    )
