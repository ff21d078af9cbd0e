"""CPU kernels of the ray caster: images and geom ids of environments.

An image starts as the stored image of the geoms that stand still. The other geoms are projected
first, so that only the tiles that any of them covers are drawn again.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from knowarm.world.render.fill_loops import Field, fill_mesh, fill_primitive
from knowarm.world.render.intersections import MESH
from knowarm.world.render.numeric import (
    Floats32,
    Images,
    Integers32,
    Matrix,
    Paint,
    Vector,
    cached_njit,
    light_geom,
    matrix_at,
    scalar,
    vector_at,
)
from knowarm.world.render.scenery import Scenery
from knowarm.world.render.tiles import TILE, TileGrid, is_empty, project_geom, tiles_of


class Stored(NamedTuple):
    """Images that every environment can start from."""

    empty: Field  # Samples of the background
    backdrop: Field  # Samples of the fixed geoms
    empty_image: Images  # Image of the background, (H * W * 3,)
    image: Images  # Image of the fixed geoms, (H * W * 3,)


class Scratch(NamedTuple):
    """Working memory of a thread."""

    field: Field  # The samples, (strips * rows * TILE,) each
    record: Floats32  # Records of the visible geoms, (G, RECORD)
    extent: Integers32  # Extents of the visible geoms, (G, EXTENT)
    # Projected vertices of a mesh, (vertices of the largest, PROJECTION)
    projection: Floats32
    # First and one past the last row of each strip that a geom covers, (strips, 2)
    dirty: Integers32


@scalar
def _write(numbers: Floats32, start: int, v: Vector) -> None:
    numbers[start], numbers[start + 1], numbers[start + 2] = v


@scalar
def _write_all(numbers: Floats32, start: int, vectors: Matrix | Paint) -> None:
    for i in range(3):
        _write(numbers, start + 3 * i, vectors[i])


@njit(error_model="numpy")
def _project_geoms(
    geoms: Integers32,
    position: Floats32,
    matrix: Floats32,
    rgba: Floats32,
    view: Floats32,
    lamps: Floats32,
    grid: TileGrid,
    scenery: Scenery,
    scratch: Scratch,
    count: int,
) -> int:
    """Append the visible geoms of a list to ``count`` records; return the new count."""
    eye = vector_at(view, 0)
    camera = matrix_at(view, 3)
    meshes = scenery.meshes
    dirty = scratch.dirty
    for g in geoms:
        if rgba[g, 3] <= 0:
            continue
        kind = scenery.kind[g]
        size = vector_at(scenery.size[g], 0)
        rotation = matrix_at(matrix[g], 0)
        window, origin, frame = project_geom(
            kind,
            size,
            vector_at(meshes.middle[g], 0),
            vector_at(meshes.half[g], 0),
            vector_at(position[g], 0),
            rotation,
            eye,
            camera,
            grid,
        )
        if is_empty(window):
            continue
        record = scratch.record[count]
        extent = scratch.extent[count]
        count += 1
        extent[0] = kind
        extent[1] = g
        extent[2], extent[3], extent[4], extent[5] = window
        sun, paint = light_geom(
            vector_at(rgba[g], 0), scenery.emission[g], lamps, rotation
        )
        _write(record, 0, origin)
        _write_all(record, 3, frame)
        _write(record, 12, size)
        _write(record, 15, sun)
        _write_all(record, 18, paint)
        first, stop, upper, lower = tiles_of(window)
        for strip in range(first, stop):
            dirty[strip, 0] = min(dirty[strip, 0], upper)
            dirty[strip, 1] = max(dirty[strip, 1], lower)
    return count


@njit(error_model="numpy")
def _has_stored_colours(scenery: Scenery, rgba: Floats32) -> bool:
    """Tell whether the fixed geoms have the colours of the stored image."""
    for g in scenery.fixed:
        for c in range(4):
            if rgba[g, c] != scenery.rgba[g, c]:
                return False
    return True


@njit(error_model="numpy")
def _copy(target: NDArray[Any], source: NDArray[Any]) -> None:
    """Copy an array; slice assignment, which Numba does not vectorize, takes much longer."""
    for i in range(target.shape[0]):
        target[i] = source[i]


@njit(error_model="numpy")
def _restore(field: Field, source: Field, dirty: Integers32, grid: TileGrid) -> None:
    """Copy the dirty samples of a stored field."""
    depth, value = field
    old_depth, old_value = source
    for strip in range(dirty.shape[0]):
        start = (strip * grid.rows + dirty[strip, 0]) * TILE
        stop = (strip * grid.rows + dirty[strip, 1]) * TILE
        _copy(depth[start:stop], old_depth[start:stop])
        _copy(value[start:stop], old_value[start:stop])


@njit(error_model="numpy")
def _average(
    value: Integers32,
    dirty: Integers32,
    grid: TileGrid,
    width: int,
    out: Images,
) -> None:
    """Average the samples of the dirty pixels into an image (H * W * 3,)."""
    samples = np.int32(grid.mask + 1)
    half = np.int32(samples >> 1)
    power = half  # 1 is 2 ** 0, and 4 is 2 ** 2
    height = np.int32(out.shape[0] // (3 * width))
    for strip in range(grid.strips):
        left = strip * TILE
        for j in range(dirty[strip, 0] >> power, min(dirty[strip, 1] >> power, height)):
            first = (strip * grid.rows + j * samples) * TILE
            pixel = (j * width + left) * 3
            for lane in range(min(TILE, width - left)):
                # Red and blue are summed in one integer, sixteen bits apart.
                outer = np.int32(half | half << 16)
                green = half
                for s in range(samples):
                    packed = value[first + s * TILE + lane]
                    outer += packed & np.int32(0xFF00FF)
                    green += (packed >> np.int32(8)) & np.int32(0xFF)
                red = pixel + 3 * lane
                out[red] = (outer >> power) & 0xFF
                out[red + 1] = green >> power
                out[red + 2] = outer >> (power + 16)


@scalar
def _row(values: NDArray[Any], e: int) -> NDArray[Any]:
    """Return the values of an environment, or those that all have."""
    return values[min(e, values.shape[0] - 1)]


@cached_njit
def render_range(
    start: int,
    stop: int,
    positions: Floats32,
    matrices: Floats32,
    rgba: Floats32,
    views: Floats32,
    lamps: Floats32,
    is_own: bool,
    grid: TileGrid,
    scenery: Scenery,
    stored: Stored,
    scratch: Scratch,
    ids: bool,
    out: Images,
) -> None:
    """Draw environments start .. stop - 1 to ``out``, (n, H, W, 3).

    Args:
        start, stop: first environment, and one past the last.
        positions, matrices: (n, G, 3) [m] and (n, G, 9), row-major, from geom to world.
        rgba: (n or 1, G, 4) colours; alpha 0 hides.
        views: (n or 1, 12) cameras.
        lamps: (n or 1, 12) lights, as ``read_lamps``.
        is_own: cameras and lights are the model's, with which the stored image was drawn.
        grid, scenery: the samples and the geoms.
        stored: images to start from.
        scratch: working memory; afterwards it holds the last environment's samples.
        ids: write geom ids instead of colours, and no image.
        out: the images; untouched with ``ids``.
    """
    field = scratch.field
    dirty = scratch.dirty
    size = stored.image.shape[0]
    for e in range(start, stop):
        colours = _row(rgba, e)
        view = _row(views, e)
        light = _row(lamps, e)
        position = positions[e]
        matrix = matrices[e]
        reuse = is_own and not ids and _has_stored_colours(scenery, colours)
        dirty[:, 0] = 0 if ids else grid.rows
        dirty[:, 1] = grid.rows if ids else 0
        fixed = scenery.fixed[:0] if reuse else scenery.fixed
        count = 0
        for geoms in (fixed, scenery.moving):
            count = _project_geoms(
                geoms,
                position,
                matrix,
                colours,
                view,
                light,
                grid,
                scenery,
                scratch,
                count,
            )
        _restore(field, stored.backdrop if reuse else stored.empty, dirty, grid)
        if ids:
            field[1][:] = -1
        for i in range(count):
            record = scratch.record[i]
            extent = scratch.extent[i]
            if extent[0] == MESH:
                fill_mesh(
                    record, extent, grid, scenery.meshes, scratch.projection, field, ids
                )
            else:
                fill_primitive(record, extent, grid, field, ids)
        if not ids:
            image = out[e].reshape(size)
            _copy(image, stored.image if reuse else stored.empty_image)
            _average(field[1], dirty, grid, out.shape[2], image)
