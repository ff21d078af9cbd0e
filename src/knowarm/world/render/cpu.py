"""CPU ray caster: images of MuJoCo geoms, compiled by Numba, without OpenGL."""

from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from mujoco import MjData, MjModel, mj_camlight, mj_kinematics
from numpy import float32, int32
from numpy.linalg import norm

from knowarm.arrays import Array, Floats32, Images
from knowarm.errors import UserError
from knowarm.world.rebuilt import Rebuilt
from knowarm.world.render.cpu_kernels import RenderBatch, Scratch, Stored, render_range
from knowarm.world.render.fill_loops import PROJECTION, Field
from knowarm.world.render.numeric import FAR, Integers32
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

# Least distance of a mesh from the camera for which triangles are added [m]
NEAREST_M = 0.2


class Trace(NamedTuple):
    """What the centre of each pixel shows."""

    geom: Integers32  # Id of the geom, -1 for none, (n, H, W)
    # Distance from the eye along the pixel's ray [m], -1 for none, (n, H, W)
    distance: Floats32


class Raycaster(Rebuilt):
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
        model: MjModel,
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
        data = MjData(model)
        mj_kinematics(model, data)
        mj_camlight(model, data)
        self.width = width
        self.height = height
        self.view, half_height = read_view(model, data, camera)
        triangle_m = None
        if mesh_triangle_px is not None:
            depth = norm(data.geom_xpos - self.view[:3], axis=1)
            pixel_m = np.maximum(depth, NEAREST_M) * (2 * half_height / height)
            triangle_m = mesh_triangle_px * pixel_m
        self.scenery = read_scenery(model, geom_groups, triangle_m)
        self.lamps = read_lamps(model, data)
        samples = ANTIALIASING if antialiasing else 1
        self.grid = make_grid(width, height, half_height, samples)
        self._pool = ThreadPoolExecutor(num_threads)
        self._scratch = []
        for _ in range(num_threads):
            self._scratch.append(_make_scratch(self.grid, self.scenery))
        self.stored = self._draw_fixed(data, background)

    @property
    def geom_rgba(self) -> Floats32:
        """Colours of the model's geoms, (G, 4), a copy to modify and pass to ``draw``."""
        return self.scenery.rgba.copy()

    def draw(
        self,
        geom_position: Array,
        geom_matrix: Array,
        geom_rgba: Floats32 | None = None,
        views: Floats32 | None = None,
        lamps: Floats32 | None = None,
    ) -> Images:
        """Draw n images as a ``Renderer``.

        With ``views`` or ``lamps``, geoms that stand still are drawn again in every image. Without
        ``geom_rgba``, geoms have the model's colours.
        """
        count = len(geom_position)
        out = np.empty((count, self.height, self.width, 3), np.uint8)
        batch = self._batch(geom_position, geom_matrix, geom_rgba, views, lamps)
        model = (batch, self.grid, self.scenery, self.stored, False, out)
        threads = min(len(self._scratch), count)
        if threads == 1:
            render_range(0, count, self._scratch[0], *model)
            return out
        tasks = []
        stop = 0
        for thread, scratch in enumerate(self._scratch[:threads], start=1):
            start = stop
            stop = count * thread // threads
            tasks.append(self._pool.submit(render_range, start, stop, scratch, *model))
        for task in tasks:
            task.result()
        return out

    def trace(
        self,
        geom_position: Array,
        geom_matrix: Array,
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
        batch = self._batch(geom_position, geom_matrix, geom_rgba)
        scratch = self._scratch[0]
        no_images = np.empty((0, 0, 0, 3), np.uint8)
        model = (scratch, batch, grid, self.scenery, self.stored, True, no_images)
        columns = np.arange(self.width)
        rows = np.arange(self.height)[:, None]
        sample = (columns >> BITS, rows * TILE + (columns & (TILE - 1)))
        x = grid.left + columns * grid.pixel
        y = grid.top - rows * grid.step
        length = np.sqrt(x * x + y * y + 1)
        geom = np.empty((count, self.height, self.width), int32)
        distance = np.empty(geom.shape, float32)
        depth, ids = scratch.field
        for e in range(count):
            render_range(e, e + 1, *model)
            geom[e] = ids[sample]
            distance[e] = np.where(geom[e] < 0, -1, depth[sample] * length)
        return Trace(geom, distance)

    def _draw_fixed(
        self, data: MjData, background: tuple[float, float, float]
    ) -> Stored:
        """Draw the background and the geoms that stand still."""
        rgb = (np.clip(background, 0.0, 1.0) * 255 + 0.5).astype(np.uint8)
        red, green, blue = rgb.tolist()
        grid = self.grid
        scenery = self.scenery
        empty = _make_field(grid, red | green << 8 | blue << 16)
        empty_image = np.tile(rgb, self.height * self.width)
        stored = Stored(empty, empty, empty_image, empty_image)
        scratch = self._scratch[0]
        # Tiles that are not drawn keep the background.
        scratch.field[1][:] = empty[1]
        image = np.empty((1, self.height, self.width, 3), np.uint8)
        batch = self._batch(data.geom_xpos[None], data.geom_xmat[None])
        fixed = scenery._replace(fixed=scenery.fixed[:0], moving=scenery.fixed)
        render_range(0, 1, scratch, batch, grid, fixed, stored, False, image)
        depth, value = scratch.field
        return stored._replace(
            backdrop=(depth.copy(), value.copy()), image=image.reshape(-1)
        )

    def _batch(
        self,
        geom_position: Array,
        geom_matrix: Array,
        geom_rgba: Floats32 | None = None,
        views: Floats32 | None = None,
        lamps: Floats32 | None = None,
    ) -> RenderBatch:
        """Return environments as the kernels take them."""
        count = len(geom_position)
        scenery = self.scenery
        geoms = len(scenery.kind)
        assert geom_position.shape == (count, geoms, 3), geom_position.shape
        assert geom_matrix.shape == (count, geoms, 9), geom_matrix.shape
        rgba = _rows(geom_rgba, scenery.rgba, count)
        has_stored_colours = rgba[:, scenery.fixed] == scenery.rgba[scenery.fixed]
        is_stored = has_stored_colours.all(axis=(1, 2))
        if views is not None or lamps is not None:
            is_stored[:] = False
        return RenderBatch(
            np.ascontiguousarray(geom_position, float32),
            np.ascontiguousarray(geom_matrix, float32),
            rgba,
            _rows(views, self.view, count),
            _rows(lamps, self.lamps, count).reshape(-1, 12),
            is_stored,
        )


def _rows(values: Floats32 | None, default: Floats32, count: int) -> Floats32:
    """Return values of each of ``count`` environments, or the default as a batch of one."""
    if values is None:
        values = default[None]
    else:
        assert values.shape == (count, *default.shape), values.shape
    return np.ascontiguousarray(values, float32)


def _make_field(grid: TileGrid, value: int) -> Field:
    shape = (grid.strips, grid.rows * TILE)
    return np.full(shape, FAR, float32), np.full(shape, value, int32)


def _make_scratch(grid: TileGrid, scenery: Scenery) -> Scratch:
    geoms = len(scenery.kind)
    span = scenery.meshes.span
    vertices = int((span[:, 1] - span[:, 0]).max(initial=0))
    return Scratch(
        field=_make_field(grid, 0),
        record=np.empty((geoms, RECORD), float32),
        extent=np.empty((geoms, EXTENT), int32),
        projection=np.empty((vertices, PROJECTION), float32),
        dirty=np.empty((grid.strips, 2), int32),
    )
