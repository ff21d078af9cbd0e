"""CPU ray caster: images of MuJoCo geoms, compiled by Numba, without OpenGL."""

from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from knowarm.errors import UserError
from knowarm.world.render.cpu_kernels import Scratch, Stored, render_range
from knowarm.world.render.fill_loops import PROJECTION, Field
from knowarm.world.render.numeric import FAR, Floats32, Images, Integers32
from knowarm.world.render.scenery import Scenery, read_lamps, read_scenery, read_view
from knowarm.world.render.tiles import (
    ANTIALIASING,
    BITS,
    EXTENT,
    RECORD,
    TILE,
    TileGrid,
    make_grid,
)

MAX_SIDE = 4096

NEAREST_M = (
    0.2  # Least distance of a mesh from the camera for which triangles are added [m]
)


class Appearance(NamedTuple):
    """What environments look like, as `render_range` takes it."""

    rgba: Floats32  # Colours of the geoms, (n or 1, G, 4)
    views: Floats32  # Cameras, (n or 1, 12)
    lamps: Floats32  # Lights, (n or 1, 12)
    is_own: bool  # Whether cameras and lights are those of the model


class Trace(NamedTuple):
    """What the centre of each pixel shows."""

    geom: Integers32  # Id of the geom, -1 for none, (n, H, W)
    # Distance from the eye along the pixel's ray [m], -1 for none, (n, H, W)
    distance: Floats32


class Raycaster:
    """Ray caster for the geoms of a model, seen by one of its cameras; a ``Renderer``.

    The same state gives the same bytes at any batch size and number of threads.

    Args:
        model: what to draw. Geoms welded to the world are drawn once and stored.
        camera: name or id of a perspective camera that stands still.
        width, height: size of the image [px]; its height is spanned by the camera's fovy.
        antialiasing: four rays per pixel in a rotated grid instead of one through its centre.
        num_threads: threads that share a batch.
        geom_groups: geom groups that are drawn; MuJoCo's renderer draws 0, 1 and 2.
        background: RGB where no geom is, in 0..1.
        mesh_triangle_px: size to which the triangles of meshes are enlarged [px], as seen from
            the camera with the joints at zero; None draws all triangles.

    Attributes:
        view: position [m] and row-major rotation of the camera, world, (12,).
        lamps: lights as in ``read_lamps``, (4, 3).
        grid: positions of the samples.
        scenery: the model's geoms.
        stored: images that every environment can start from.
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
        mesh_triangle_px: float | None = None,
    ) -> None:
        for name, side in (("width", width), ("height", height)):
            if not 1 <= side <= MAX_SIDE:
                raise UserError(
                    f"Raycaster {name} must lie in 1 to {MAX_SIDE}, got {side}."
                )
        if num_threads < 1:
            raise UserError(
                f"Raycaster num_threads must be at least 1, got {num_threads}."
            )
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        self.width = width
        self.height = height
        self.view, half_height = read_view(model, data, camera)
        triangle_m = None
        if mesh_triangle_px is not None:
            depth = np.linalg.norm(data.geom_xpos - self.view[:3], axis=1)
            pixel_m = np.maximum(depth, NEAREST_M) * (2 * half_height / height)
            triangle_m = mesh_triangle_px * pixel_m
        self.scenery = read_scenery(model, geom_groups, triangle_m)
        self.lamps = read_lamps(model, data)
        self.grid = make_grid(
            width, height, half_height, ANTIALIASING if antialiasing else 1
        )
        self._pool = ThreadPoolExecutor(num_threads) if num_threads > 1 else None
        self._positions = np.empty((0, 0, 3), dtype=np.float32)
        self._matrices = np.empty((0, 0, 9), dtype=np.float32)
        self._scratch = [
            _make_scratch(self.grid, self.scenery) for _ in range(num_threads)
        ]
        self.stored = self._draw_fixed(data, background)

    @property
    def geom_rgba(self) -> Floats32:
        """Colours of the model's geoms, (G, 4), a copy to modify and pass to ``draw``."""
        return self.scenery.rgba.copy()

    def draw(
        self,
        geom_position: NDArray[Any],
        geom_matrix: NDArray[Any],
        geom_rgba: Floats32 | None = None,
        views: Floats32 | None = None,
        lamps: Floats32 | None = None,
        *,
        out: Images | None = None,
    ) -> Images:
        """Draw n images as a ``Renderer``, into ``out`` if given.

        With ``views`` or ``lamps``, geoms that stand still are drawn again in every image. Without
        ``geom_rgba``, geoms have the model's colours.
        """
        count = len(geom_position)
        if out is None:
            out = np.empty((count, self.height, self.width, 3), dtype=np.uint8)
        assert out.shape == (count, self.height, self.width, 3)
        assert out.flags.c_contiguous
        poses = self._poses(geom_position, geom_matrix)
        appearance = self._appearance(count, geom_rgba, views, lamps)
        if self._pool is None or count == 1:
            self._draw_range(0, count, poses, appearance, 0, out)
            return out
        threads = min(len(self._scratch), count)
        tasks = []
        for thread in range(threads):
            start = count * thread // threads
            stop = count * (thread + 1) // threads
            arguments = (start, stop, poses, appearance, thread, out)
            tasks.append(self._pool.submit(self._draw_range, *arguments))
        for task in tasks:
            task.result()
        return out

    def trace(
        self,
        geom_position: NDArray[Any],
        geom_matrix: NDArray[Any],
        geom_rgba: Floats32 | None = None,
    ) -> Trace:
        """Find what the centre of each pixel shows, with the kernels that draw."""
        if self.grid.mask:
            raise UserError(
                "Raycaster.trace needs antialiasing=False, because the rays of one pixel can hit "
                "different geoms; construct another Raycaster for it."
            )
        count = len(geom_position)
        grid = self.grid
        poses = self._poses(geom_position, geom_matrix)
        appearance = self._appearance(count, geom_rgba)
        columns = np.arange(self.width)
        rows = np.arange(self.height)[:, None]
        index = ((columns >> BITS) * grid.rows + rows) * TILE + (columns & (TILE - 1))
        x = grid.left + columns * grid.pixel
        y = grid.top - rows * grid.step
        length = np.sqrt(x * x + y * y + 1)
        geom = np.empty((count, self.height, self.width), dtype=np.int32)
        distance = np.empty(geom.shape, dtype=np.float32)
        depth, ids = self._scratch[0].field
        for e in range(count):
            self._draw_range(e, e + 1, poses, appearance, 0, None)
            geom[e] = ids[index]
            distance[e] = np.where(geom[e] < 0, -1, depth[index] * length)
        return Trace(geom, distance)

    def _draw_fixed(
        self, data: mujoco.MjData, background: tuple[float, float, float]
    ) -> Stored:
        """Draw the background and the geoms that stand still."""
        rgb = (np.clip(background, 0.0, 1.0) * 255 + 0.5).astype(np.uint8)
        red, green, blue = rgb.tolist()
        empty = _make_field(self.grid, red | green << 8 | blue << 16)
        empty_image = np.tile(rgb, self.height * self.width)
        image = np.empty((1, self.height, self.width, 3), dtype=np.uint8)
        scenery = self.scenery
        self.stored = Stored(empty, empty, empty_image, empty_image)
        self.scenery = scenery._replace(fixed=scenery.fixed[:0], moving=scenery.fixed)
        poses = self._poses(data.geom_xpos[None], data.geom_xmat[None])
        self._draw_range(0, 1, poses, self._appearance(1), 0, image)
        self.scenery = scenery
        # Only the tiles that were touched are in the scratch field.
        scratch = self._scratch[0]
        backdrop = (empty[0].copy(), empty[1].copy())
        for strip, dirty in enumerate(scratch.dirty):
            first, last = (strip * self.grid.rows + dirty) * TILE
            for target, source in zip(backdrop, scratch.field, strict=True):
                target[first:last] = source[first:last]
        return Stored(empty, backdrop, empty_image, image.reshape(-1))

    def _draw_range(
        self,
        start: int,
        stop: int,
        poses: tuple[Floats32, Floats32],
        appearance: Appearance,
        thread: int,
        out: Images | None,
    ) -> None:
        """Draw environments start .. stop - 1; without ``out``, leave geom ids in the scratch."""
        ids = out is None
        if out is None:
            out = np.empty((0, 0, 0, 3), dtype=np.uint8)
        model = (self.grid, self.scenery, self.stored)
        render_range(
            start, stop, *poses, *appearance, *model, self._scratch[thread], ids, out
        )

    def _appearance(
        self,
        count: int,
        geom_rgba: Floats32 | None = None,
        views: Floats32 | None = None,
        lamps: Floats32 | None = None,
    ) -> Appearance:
        """Return colours, cameras and lights: one for all environments, or one per environment."""
        return Appearance(
            _batch(geom_rgba, self.scenery.rgba, count),
            _batch(views, self.view, count),
            _batch(lamps, self.lamps, count).reshape(-1, 12),
            is_own=views is None and lamps is None,
        )

    def _poses(
        self, geom_position: NDArray[Any], geom_matrix: NDArray[Any]
    ) -> tuple[Floats32, Floats32]:
        """Copy poses to reused float32 arrays."""
        count = len(geom_position)
        geoms = len(self.scenery.kind)
        assert geom_position.shape == (count, geoms, 3), geom_position.shape
        assert geom_matrix.shape == (count, geoms, 9), geom_matrix.shape
        if len(self._positions) < count:
            self._positions = np.empty((count, geoms, 3), dtype=np.float32)
            self._matrices = np.empty((count, geoms, 9), dtype=np.float32)
        positions = self._positions[:count]
        matrices = self._matrices[:count]
        np.copyto(positions, geom_position, casting="same_kind")
        np.copyto(matrices, geom_matrix, casting="same_kind")
        return positions, matrices


def _batch(values: Floats32 | None, default: Floats32, count: int) -> Floats32:
    """Return values of each of ``count`` environments, or the default as a batch of one."""
    if values is None:
        values = default[None]
    else:
        assert values.shape == (count, *default.shape), values.shape
    return np.ascontiguousarray(values, dtype=np.float32)


def _make_field(grid: TileGrid, value: int) -> Field:
    count = grid.strips * grid.rows * TILE
    return np.full(count, FAR, dtype=np.float32), np.full(count, value, dtype=np.int32)


def _make_scratch(grid: TileGrid, scenery: Scenery) -> Scratch:
    geoms = len(scenery.kind)
    span = scenery.meshes.span
    vertices = int((span[:, 1] - span[:, 0]).max(initial=0))
    return Scratch(
        field=_make_field(grid, 0),
        record=np.empty((geoms, RECORD), dtype=np.float32),
        extent=np.empty((geoms, EXTENT), dtype=np.int32),
        projection=np.empty((vertices, PROJECTION), dtype=np.float32),
        dirty=np.empty((grid.strips, 2), dtype=np.int32),
    )
