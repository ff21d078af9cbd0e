"""CPU kernels of the ray caster: images and geom ids of environments.

An image starts as the stored image of the geoms that stand still. The other geoms are projected
first, so that only the tiles that any of them covers are drawn again.
"""

from typing import Any, NamedTuple

from numpy import int32

from knowarm.arrays import Array, Floats32, Images, Mask
from knowarm.world.render.fill_loops import (
    Field,
    fill_mesh,
    fill_primitive,
    rows_of,
)
from knowarm.world.render.intersections import MESH
from knowarm.world.render.numeric import (
    Integers32,
    cached_njit,
    kernel,
    light_geom,
    matrix_at,
    scalar,
    vector_at,
    write_matrix,
    write_vector,
)
from knowarm.world.render.scenery import Scenery
from knowarm.world.render.tiles import TILE, TileGrid, is_empty, project_geom, tiles_of


class RenderBatch(NamedTuple):
    """Poses and appearance of n environments; one row of appearance can stand for all."""

    position: Floats32  # Positions of the geoms [m], (n, G, 3)
    matrix: Floats32  # Rotations from geom to world, row-major, (n, G, 9)
    rgba: Floats32  # Colours of the geoms, alpha 0 hides, (n or 1, G, 4)
    views: Floats32  # Cameras, (n or 1, 12)
    lamps: Floats32  # Lights, as ``read_lamps``, (n or 1, 12)
    # Whether the fixed geoms, the camera and the lights are those of the stored image, (n or 1,)
    is_stored: Mask


class Stored(NamedTuple):
    """Images that every environment can start from."""

    empty: Field  # Samples of the background
    backdrop: Field  # Samples of the fixed geoms
    empty_image: Images  # Image of the background, (H * W * 3,)
    image: Images  # Image of the fixed geoms, (H * W * 3,)


class Scratch(NamedTuple):
    """Working memory of a thread."""

    field: Field  # The samples
    record: Floats32  # Records of the visible geoms, (G, RECORD)
    extent: Integers32  # Extents of the visible geoms, (G, EXTENT)
    # Projected vertices of a mesh, (vertices of the largest, PROJECTION)
    projection: Floats32
    # First and one past the last row of each strip that a geom covers, (strips, 2)
    dirty: Integers32


@kernel
def _project_geoms(
    geoms: Integers32,
    batch: RenderBatch,
    e: int,
    grid: TileGrid,
    scenery: Scenery,
    scratch: Scratch,
    count: int,
) -> int:
    """Append the visible geoms of a list to ``count`` records; return the new count."""
    rgba = _row(batch.rgba, e)
    lamps = _row(batch.lamps, e)
    view = _row(batch.views, e)
    eye = vector_at(view, 0)
    camera = matrix_at(view, 3)
    meshes = scenery.meshes
    dirty = scratch.dirty
    for g in geoms:
        if rgba[g, 3] <= 0:
            continue
        kind = scenery.kind[g]
        size = vector_at(scenery.size[g], 0)
        middle = vector_at(meshes.middle[g], 0)
        half = vector_at(meshes.half[g], 0)
        position = vector_at(batch.position[e, g], 0)
        matrix = matrix_at(batch.matrix[e, g], 0)
        window, origin, frame = project_geom(
            kind, size, middle, half, position, matrix, eye, camera, grid
        )
        if is_empty(window):
            continue
        record = scratch.record[count]
        extent = scratch.extent[count]
        count += 1
        extent[0] = kind
        extent[1] = g
        extent[2], extent[3], extent[4], extent[5] = window
        colour = vector_at(rgba[g], 0)
        sun, paint = light_geom(colour, scenery.emission[g], lamps, matrix)
        write_vector(record, 0, origin)
        write_matrix(record, 3, frame)
        write_vector(record, 12, size)
        write_vector(record, 15, sun)
        write_matrix(record, 18, paint)
        first, stop, upper, lower = tiles_of(window)
        for strip in range(first, stop):
            dirty[strip, 0] = min(dirty[strip, 0], upper)
            dirty[strip, 1] = max(dirty[strip, 1], lower)
    return count


@kernel
def _copy(target: Array, source: Array) -> None:
    """Copy an array; slice assignment, which Numba does not vectorize, takes much longer."""
    for i in range(len(target)):
        target[i] = source[i]


@kernel
def _restore(field: Field, source: Field, dirty: Integers32) -> None:
    """Copy the dirty samples of a stored field."""
    for strip in range(len(dirty)):
        first = dirty[strip, 0]
        stop = dirty[strip, 1]
        depth, value = rows_of(field, strip, first, stop)
        stored_depth, stored_value = rows_of(source, strip, first, stop)
        _copy(depth, stored_depth)
        _copy(value, stored_value)


@kernel
def _average(
    value: Integers32, dirty: Integers32, grid: TileGrid, width: int, out: Images
) -> None:
    """Average the samples of the dirty pixels into an image (H * W * 3,)."""
    samples = int32(grid.mask + 1)
    half = int32(samples >> 1)
    power = half  # 1 is 2 ** 0, and 4 is 2 ** 2
    height = int32(out.shape[0] // (3 * width))
    for strip in range(grid.strips):
        left = strip * TILE
        for j in range(dirty[strip, 0] >> power, min(dirty[strip, 1] >> power, height)):
            first = j * samples * TILE
            pixel = (j * width + left) * 3
            for lane in range(min(TILE, width - left)):
                # Red and blue are summed in one integer, sixteen bits apart.
                outer = int32(half | half << 16)
                green = half
                for s in range(samples):
                    packed = value[strip, first + s * TILE + lane]
                    outer += packed & int32(0xFF00FF)
                    green += (packed >> int32(8)) & int32(0xFF)
                red = pixel + 3 * lane
                out[red] = (outer >> power) & 0xFF
                out[red + 1] = green >> power
                out[red + 2] = outer >> (power + 16)


@scalar
def _row(values: Array, e: int) -> Any:
    """Return the values of an environment, or those that all have."""
    return values[min(e, len(values) - 1)]


@cached_njit
def render_range(
    start: int,
    stop: int,
    scratch: Scratch,
    batch: RenderBatch,
    grid: TileGrid,
    scenery: Scenery,
    stored: Stored,
    ids: bool,
    out: Images,
) -> None:
    """Draw environments start .. stop - 1 to ``out``, (n, H, W, 3).

    Args:
        start, stop: first environment, and one past the last.
        scratch: working memory; afterwards it holds the last environment's samples.
        batch: the environments.
        grid, scenery: the samples and the geoms.
        stored: images to start from.
        ids: write geom ids instead of colours, and no image.
        out: the images; untouched with ``ids``.
    """
    field = scratch.field
    dirty = scratch.dirty
    for e in range(start, stop):
        geoms = scenery.fixed
        samples = stored.empty
        background = stored.empty_image
        if _row(batch.is_stored, e) and not ids:
            geoms = geoms[:0]
            samples = stored.backdrop
            background = stored.image
        dirty[:, 0] = 0 if ids else grid.rows
        dirty[:, 1] = grid.rows if ids else 0
        count = _project_geoms(geoms, batch, e, grid, scenery, scratch, 0)
        count = _project_geoms(scenery.moving, batch, e, grid, scenery, scratch, count)
        _restore(field, samples, dirty)
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
            image = out[e].reshape(background.shape)
            _copy(image, background)
            _average(field[1], dirty, grid, out.shape[2], image)
