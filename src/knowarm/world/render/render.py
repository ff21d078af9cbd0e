"""Poses and colours of a batch go in; images come out, on one CPU thread.

Every image begins as that of the geoms that stand still. The other geoms are prepared first, so
that only the tiles which any of them can touch are drawn again.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from knowarm.world.render.fill import Field, fill
from knowarm.world.render.fill_mesh import fill_mesh
from knowarm.world.render.grid import BITS, TILE, Grid
from knowarm.world.render.meshes import Meshes
from knowarm.world.render.numeric import Vector, entry, scalar
from knowarm.world.render.prepare import nine, prepare, prepare_light, triple
from knowarm.world.render.tables import MESH


class Scenery(NamedTuple):
    """What all environments share. G geoms, F fixed and M moving ones that are drawn."""

    kind: NDArray[np.int32]
    """Types of the geoms, (G,)."""

    size: NDArray[np.float32]
    """``geom_size`` [m], (G, 3)."""

    glow: NDArray[np.float32]
    """Emission of the geoms' materials, (G,)."""

    meshes: Meshes
    """The triangles of mesh geoms."""

    rgba: NDArray[np.float32]
    """The model's colours, (G, 4)."""

    fixed: NDArray[np.int32]
    """Ids of the geoms that stand still, (F,)."""

    moving: NDArray[np.int32]
    """Ids of the other geoms, (M,)."""

    empty: Field
    """Samples of nothing."""

    backdrop: Field
    """Samples of the fixed geoms."""

    nothing: NDArray[np.uint8]
    """Image of nothing, (H * W * 3,)."""

    image: NDArray[np.uint8]
    """Image of the fixed geoms, (H * W * 3,)."""


class Scratch(NamedTuple):
    """What a thread draws in."""

    field: Field
    """The samples, (strips * rows * TILE,) each."""

    record: NDArray[np.float32]
    """Records of the visible geoms, (G, RECORD)."""

    extent: NDArray[np.int32]
    """Extents of the visible geoms, (G, EXTENT)."""

    projection: NDArray[np.float32]
    """Projected vertices of a mesh, (PROJECTION, vertices of the largest)."""

    dirty: NDArray[np.int32]
    """First and one past the last row of each strip that a geom can touch, (strips, 2)."""


@scalar
def _write(numbers: NDArray[np.float32], start: int, v: Vector) -> None:
    numbers[start], numbers[start + 1], numbers[start + 2] = v


@njit(error_model="numpy")
def _prepare_list(
    geoms: NDArray[np.int32],
    position: NDArray[np.float32],
    matrix: NDArray[np.float32],
    rgba: NDArray[np.float32],
    view: NDArray[np.float32],
    lamps: NDArray[np.float32],
    grid: Grid,
    scenery: Scenery,
    scratch: Scratch,
    count: int,
) -> int:
    """Prepare the visible geoms of a list after the ``count`` that are; return how many are now."""
    eye, camera = triple(view, 0), nine(view, 3)
    lights = (triple(lamps, 0), triple(lamps, 3), triple(lamps, 6), triple(lamps, 9))
    meshes, dirty = scenery.meshes, scratch.dirty
    for g in geoms:
        if rgba[g, 3] <= 0:
            continue
        kind, size, own = scenery.kind[g], triple(scenery.size[g], 0), nine(matrix[g], 0)
        visible, window, origin, frame = prepare(
            kind, size, triple(meshes.middle[g], 0), triple(meshes.half[g], 0),
            triple(position[g], 0), own, eye, camera, grid,
        )  # fmt: skip
        if not visible:
            continue
        record, extent = scratch.record[count], scratch.extent[count]
        count += 1
        extent[0], extent[1] = kind, g
        extent[2], extent[3], extent[4], extent[5] = window
        sun, colours = prepare_light(triple(rgba[g], 0), scenery.glow[g], lights, own)
        _write(record, 0, origin)
        for i in range(9):
            record[3 + i] = frame[i]
        _write(record, 12, size)
        _write(record, 15, sun)
        for i in range(3):
            _write(record, 18 + 3 * i, colours[i])
        upper = np.int32(extent[4] >> BITS << BITS)
        lower = np.int32((extent[5] >> BITS << BITS) + TILE)
        for strip in range(extent[2] >> BITS, (extent[3] >> BITS) + 1):
            dirty[strip, 0] = min(dirty[strip, 0], upper)
            dirty[strip, 1] = max(dirty[strip, 1], lower)
    return count


@njit(error_model="numpy")
def _as_fixed(scenery: Scenery, rgba: NDArray[np.float32]) -> bool:
    """Whether the fixed geoms look as in the kept image."""
    for g in scenery.fixed:
        for c in range(4):
            if rgba[g, c] != scenery.rgba[g, c]:
                return False
    return True


@njit(error_model="numpy")
def _begin(field: Field, source: Field, dirty: NDArray[np.int32], grid: Grid) -> None:
    """Copy the dirty samples of a kept field."""
    for strip in range(dirty.shape[0]):
        start, stop = (
            (strip * grid.rows + dirty[strip, 0]) * TILE,
            (strip * grid.rows + dirty[strip, 1]) * TILE,
        )
        depth, value = field[0][start:stop], field[1][start:stop]
        old_depth, old_value = source[0][start:stop], source[1][start:stop]
        for k in range(stop - start):
            depth[k] = old_depth[k]
            value[k] = old_value[k]


@njit(error_model="numpy")
def _average(
    value: NDArray[np.int32],
    dirty: NDArray[np.int32],
    grid: Grid,
    width: int,
    out: NDArray[np.uint8],
) -> None:
    """Average the samples of the dirty pixels into a image (H * W * 3,)."""
    samples = np.int32(grid.mask + 1)
    power = np.int32(samples >> 1)  # 1 is 2 ** 0, and 4 is 2 ** 2
    height = np.int32(out.shape[0] // (3 * width))
    half = np.int32(samples >> 1)
    for strip in range(grid.strips):
        for j in range(dirty[strip, 0] >> power, min(dirty[strip, 1] >> power, height)):
            first = (strip * grid.rows + j * samples) * TILE
            pixel = (j * width + strip * TILE) * 3
            for lane in range(min(TILE, width - strip * TILE)):
                # Red and blue are summed in one integer, sixteen bits apart.
                outer, green = np.int32(half | half << 16), half
                for s in range(samples):
                    packed = value[first + s * TILE + lane]
                    outer += packed & np.int32(0xFF00FF)
                    green += (packed >> np.int32(8)) & np.int32(0xFF)
                out[pixel + 3 * lane] = (outer >> power) & 0xFF
                out[pixel + 3 * lane + 1] = green >> power
                out[pixel + 3 * lane + 2] = outer >> (power + 16)


@entry
def render_range(
    start: int,
    stop: int,
    positions: NDArray[np.float32],
    matrices: NDArray[np.float32],
    rgba: NDArray[np.float32],
    views: NDArray[np.float32],
    lamps: NDArray[np.float32],
    grid: Grid,
    scenery: Scenery,
    scratch: Scratch,
    ids: bool,
    out: NDArray[np.uint8],
) -> None:
    """Draw environments start .. stop - 1.

    Args:
        start: first environment.
        stop: one past the last.
        positions: (n, G, 3) world positions of geoms.
        matrices: (n, G, 9) row-major rotations from geom to world.
        rgba: (n or 1, G, 4); alpha 0 hides.
        views: (n or 1, 12) cameras; with one for all, the kept image of fixed geoms serves.
        lamps: (n or 1, 12) as ``Tables.lamps``; likewise.
        grid: the samples.
        scenery: what all environments share.
        scratch: what to draw in; the last environment's samples stay there.
        ids: write geom ids instead of colours, and no image.
        out: (n, H, W, 3) images to write; with ``ids`` untouched.
    """
    field, dirty = scratch.field, scratch.dirty
    size = scenery.nothing.shape[0]
    shared = (views.shape[0] == 1) & (lamps.shape[0] == 1) & (not ids)
    for e in range(start, stop):
        colours = rgba[min(e, rgba.shape[0] - 1)]
        view, light = views[min(e, views.shape[0] - 1)], lamps[min(e, lamps.shape[0] - 1)]
        keeps = shared and _as_fixed(scenery, colours)
        dirty[:, 0] = grid.rows
        dirty[:, 1] = 0
        count = 0
        if not keeps:
            count = _prepare_list(
                scenery.fixed, positions[e], matrices[e], colours, view, light, grid, scenery,
                scratch, count,
            )  # fmt: skip
        count = _prepare_list(
            scenery.moving, positions[e], matrices[e], colours, view, light, grid, scenery,
            scratch, count,
        )  # fmt: skip
        source = scenery.backdrop if keeps else scenery.empty
        if ids:
            dirty[:, 0] = 0
            dirty[:, 1] = grid.rows
        _begin(field, source, dirty, grid)
        if ids:
            field[1][:] = -1
        for i in range(count):
            record, extent = scratch.record[i], scratch.extent[i]
            if extent[0] == MESH:
                fill_mesh(record, extent, grid, scenery.meshes, scratch.projection, field, ids)
            else:
                fill(record, extent, grid, field, ids)
        if not ids:
            image, kept = out[e].reshape(size), scenery.image if keeps else scenery.nothing
            for i in range(size):
                image[i] = kept[i]
            _average(field[1], dirty, grid, out.shape[2], image)
