"""CUDA kernels of the ray caster: one thread per geom projects it, one thread per pixel draws it.

Between the two, one thread per column and per row of tiles collects the geoms whose projection
reaches it in 64-bit masks. A pixel then tests the geoms in both of its masks, and no others.

The kernels call the functions that the CPU's loops consist of, in the same order, and no
multiplication and addition are fused, so CPU and GPU draw the same image.

Numba's simulator must be able to run the kernels: there, a compiled function returns Python floats,
float32 values of type float64, which ``np.float32`` converts back.
"""

from collections.abc import Callable
from inspect import signature
from typing import Any

import numpy as np

from knowarm.private_apis import import_numba_cuda
from knowarm.world.render.intersections import (
    MESH,
    Hit,
    blend,
    face_planes,
    intersect,
    triangle,
)
from knowarm.world.render.numeric import FAR, ZERO, Matrix, Vector, minus, scalar
from knowarm.world.render.shading import Paint, light_geom, shade
from knowarm.world.render.tiles import (
    BITS,
    TILE,
    Grid,
    project_geom,
    sample_direction,
    sample_point,
)

cuda: Any = import_numba_cuda()
"""Numba's CUDA module; its type annotations do not cover kernels."""

Array = Any
"""A device array."""

HIDDEN = -1
"""Kind in the extent of a geom that is not drawn."""

WORD = 64
"""Geoms per word of a mask."""

ACROSS, DOWN = 8, 4
"""Columns and rows of the pixels that the 32 threads of a warp draw: neighbours in both directions
test nearly the same geoms, which keeps the threads of a warp together."""

_NONE, _LOWEST = np.uint64(0), np.uint64(1)

# Link-time optimization, numba-cuda's default, would fuse operations again.
_OPTIONS = {"lto": False} if "lto" in signature(cuda.jit).parameters else {}


def kernel(function: Callable[..., None]) -> Any:
    """Compile a kernel at its first launch."""
    return cuda.jit(function, **_OPTIONS)


@scalar
def _hit_geom(
    kind: np.int32, origin: Vector, frame: Matrix, size: Vector, x: np.float32, y: np.float32
) -> Hit:
    """Intersect a sample with a primitive: depth and normal in the geom's frame."""
    return intersect(kind, origin, sample_direction(x, y, frame), size)


@scalar
def _hit_triangle(
    origin: Vector, frame: Matrix, a: Vector, b: Vector, c: Vector, x: np.float32, y: np.float32
) -> Hit:
    """Intersect a sample with a triangle of a mesh: depth and weights of the corners."""
    planes = face_planes(minus(a, origin), minus(b, origin), minus(c, origin))
    return triangle(planes, sample_direction(x, y, frame))


@scalar
def _colour(normal: Vector, frame: Matrix, sun: Vector, paint: Paint) -> np.int32:
    """Shade a surface; the normal is in the geom's frame."""
    return shade(normal, (frame[6], frame[7], frame[8]), sun, paint)


@scalar
def _smooth_colour(
    weights: Vector, a: Vector, b: Vector, c: Vector, frame: Matrix, sun: Vector, paint: Paint
) -> np.int32:
    """Shade a triangle with the normal interpolated between its corners' normals."""
    return _colour(blend(weights, a, b, c), frame, sun, paint)


@cuda.jit(device=True)
def _three(numbers: Array, start: int) -> Vector:
    return (
        np.float32(numbers[start]),
        np.float32(numbers[start + 1]),
        np.float32(numbers[start + 2]),
    )


@cuda.jit(device=True)
def _nine(numbers: Array, start: int) -> Matrix:
    a, b, c = _three(numbers, start), _three(numbers, start + 3), _three(numbers, start + 6)
    return a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2]


@cuda.jit(device=True)
def _write(numbers: Array, start: int, v: Vector) -> None:
    numbers[start], numbers[start + 1], numbers[start + 2] = v[0], v[1], v[2]


@cuda.jit(device=True)
def _floats(v: Vector) -> Vector:
    return np.float32(v[0]), np.float32(v[1]), np.float32(v[2])


@kernel
def fill_kernel(numbers: Array, value: int) -> None:
    """Set all elements to a value."""
    index = cuda.grid(1)
    if index < numbers.shape[0]:
        numbers[index] = value


@kernel
def project_kernel(
    order: Array,
    fixed: int,
    shape: tuple[Array, ...],
    own_rgba: Array,
    position: Array,
    matrix: Array,
    rgba: Array,
    views: Array,
    lamps: Array,
    grid: Grid,
    record: Array,
    extent: Array,
    redraw: Array,
    wanted: Array,
) -> None:
    """Project one geom of one environment.

    Args:
        order: (D,) ids of the drawn geoms, those that stand still first.
        fixed: number of geoms that stand still.
        shape: kind (G,), size (G, 3), emission (G,), middle (G, 3) and half (G, 3) of the geoms.
        own_rgba: (G, 4) colours of the model.
        position: (n, G, 3) world positions.
        matrix: (n, G, 9) row-major rotations from geom to world.
        rgba: (n or 1, G, 4) colours; alpha 0 hides.
        views: (n or 1, 12) cameras.
        lamps: (n or 1, 12) lights.
        grid: the samples.
        record: (n, D, RECORD) to write.
        extent: (n, D, EXTENT) to write, in tiles; kind ``HIDDEN`` for invisible geoms.
        redraw: (n,) set to 1 where the stored image of the fixed geoms cannot be used.
        wanted: (n or 1,) bool; the other environments are skipped.
    """
    index = cuda.grid(1)
    e, slot = index // order.shape[0], index % order.shape[0]
    if e >= position.shape[0] or not wanted[min(e, wanted.shape[0] - 1)]:
        return
    g = order[slot]
    colour = rgba[min(e, rgba.shape[0] - 1), g]
    view, lamp = views[min(e, views.shape[0] - 1)], lamps[min(e, lamps.shape[0] - 1)]
    if slot < fixed:
        for c in range(4):
            if colour[c] != own_rgba[g, c]:
                redraw[e] = 1
    own = _nine(matrix[e, g], 0)
    visible, window, origin, frame = project_geom(
        shape[0][g], _three(shape[1][g], 0), _three(shape[3][g], 0), _three(shape[4][g], 0),
        _three(position[e, g], 0), own, _three(view, 0), _nine(view, 3), grid,
    )  # fmt: skip
    target, numbers = extent[e, slot], record[e, slot]
    target[0] = shape[0][g] if visible and colour[3] > 0 else HIDDEN
    target[1] = g
    # Tiles instead of samples, because the CPU draws whole tiles.
    for i in range(4):
        target[2 + i] = window[i] >> BITS
    lights = _three(lamp, 0), _three(lamp, 3), _three(lamp, 6), _three(lamp, 9)
    sun, paint = light_geom(_three(colour, 0), shape[2][g], lights, own)
    _write(numbers, 0, origin)
    for i in range(9):
        numbers[3 + i] = frame[i]
    _write(numbers, 12, _three(shape[1][g], 0))
    _write(numbers, 15, sun)
    for i in range(3):
        _write(numbers, 18 + 3 * i, paint[i])


@kernel
def mask_kernel(
    extent: Array, fixed: int, redraw: Array, strips: int, wanted: Array, masks: Array
) -> None:
    """Collect the geoms in one column or row of tiles of one environment.

    Args:
        extent: (n, D, EXTENT) from ``project_kernel``.
        fixed: number of geoms in the stored image.
        redraw: (n,) 1 where these geoms are drawn again.
        strips: number of columns of tiles.
        wanted: (n or 1,) bool; the other environments are skipped.
        masks: (n, columns + rows of tiles, words) uint64 to write: bit b of word w is set if geom
            64 w + b has to be tested there.
    """
    index = cuda.grid(1)
    word, place = index % masks.shape[2], index // masks.shape[2]
    e, line = place // masks.shape[1], place % masks.shape[1]
    if e >= masks.shape[0] or not wanted[min(e, wanted.shape[0] - 1)]:
        return
    low, tile = (2, line) if line < strips else (4, line - strips)
    start = word * WORD
    bits = _NONE
    for slot in range(start, min(start + WORD, extent.shape[1])):
        tiles = extent[e, slot]
        drawn = (slot >= fixed or redraw[e]) and tiles[0] != HIDDEN
        if drawn and tiles[low] <= tile and tile <= tiles[low + 1]:
            bits = bits | (_LOWEST << np.uint64(slot - start))
    masks[e, line, word] = bits


@kernel
def draw_kernel(
    record: Array,
    extent: Array,
    masks: Array,
    redraw: Array,
    grid: Grid,
    backdrop: tuple[Array, Array],
    background: int,
    triangles: tuple[Array, Array, Array, Array],
    wanted: Array,
    out: Array,
) -> None:
    """Draw one pixel of one environment.

    Args:
        record: (n, D, RECORD) from ``project_kernel``.
        extent: (n, D, EXTENT) from ``project_kernel``.
        masks: (n, columns + rows of tiles, words) from ``mask_kernel``.
        redraw: (n,) 1 where the geoms of the stored image are drawn again.
        grid: the samples.
        backdrop: depth and packed colour of the fixed geoms' samples.
        background: packed colour where no geom is.
        triangles: ``Meshes.vertex``, ``face``, ``normal`` and ``span``.
        wanted: (n or 1,) bool; the other environments are skipped.
        out: (n, H, W, 3) uint8 to write.
    """
    index = cuda.grid(1)
    height, width = out.shape[1], out.shape[2]
    warps = (width + ACROSS - 1) // ACROSS
    lane, warp = index % (ACROSS * DOWN), index // (ACROSS * DOWN)
    blocks = warps * ((height + DOWN - 1) // DOWN)
    e, block = warp // blocks, warp % blocks
    if e >= out.shape[0] or not wanted[min(e, wanted.shape[0] - 1)]:
        return
    j = block // warps * DOWN + lane // ACROSS
    i = block % warps * ACROSS + lane % ACROSS
    if j >= height or i >= width:
        return
    vertex, face, corner_normal, span = triangles
    samples = grid.mask + 1
    # A pixel's samples lie in one tile: their number divides the tile's side.
    column, line = masks[e, i >> BITS], masks[e, grid.strips + ((j * samples) >> BITS)]
    half = samples >> 1
    red, green, blue = half, half, half
    for s in range(samples):
        row = j * samples + s
        sample = sample_point(np.int32(i), np.int32(row), grid)
        x, y = np.float32(sample[0]), np.float32(sample[1])
        depth, value = FAR, np.int32(background)
        if not redraw[e]:
            place = ((i >> BITS) * grid.rows + row) * TILE + (i & (TILE - 1))
            depth, value = backdrop[0][place], backdrop[1][place]
        nearest, nearest_face = -1, -1
        nx, ny, nz = ZERO, ZERO, ZERO
        for word in range(masks.shape[2]):
            bits = column[word] & line[word]
            while bits != _NONE:
                rest = bits - _LOWEST
                slot = word * WORD + cuda.popc(rest & ~bits)
                bits = bits & rest
                kind, numbers = extent[e, slot, 0], record[e, slot]
                origin, frame = _three(numbers, 0), _nine(numbers, 3)
                if kind == MESH:
                    g = extent[e, slot, 1]
                    for f in range(span[g, 2], span[g, 3]):
                        hit = _hit_triangle(
                            origin, frame, _three(vertex[face[f, 0]], 0),
                            _three(vertex[face[f, 1]], 0), _three(vertex[face[f, 2]], 0), x, y,
                        )  # fmt: skip
                        if np.float32(hit[0]) < depth:
                            depth, nearest, nearest_face = np.float32(hit[0]), slot, f
                            nx, ny, nz = _floats(hit[1])
                else:
                    hit = _hit_geom(kind, origin, frame, _three(numbers, 12), x, y)
                    if np.float32(hit[0]) < depth:
                        depth, nearest = np.float32(hit[0]), slot
                        nx, ny, nz = _floats(hit[1])
        if nearest >= 0:
            numbers = record[e, nearest]
            frame, sun = _nine(numbers, 3), _three(numbers, 15)
            paint = _three(numbers, 18), _three(numbers, 21), _three(numbers, 24)
            if extent[e, nearest, 0] == MESH:
                normals = corner_normal[nearest_face]
                value = _smooth_colour(
                    (nx, ny, nz), _three(normals, 0), _three(normals, 3), _three(normals, 6),
                    frame, sun, paint,
                )  # fmt: skip
            else:
                value = _colour((nx, ny, nz), frame, sun, paint)
        red += value & 255
        green += (value >> 8) & 255
        blue += (value >> 16) & 255
    out[e, j, i, 0] = red // samples
    out[e, j, i, 1] = green // samples
    out[e, j, i, 2] = blue // samples
