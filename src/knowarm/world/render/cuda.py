"""Poses and colours of a batch on a GPU go in; images come out there, without a copy to the host.

Two kernels: one thread a geom places it before the camera, one thread a pixel draws. Both call the
functions that the CPU's loops are made of, in the same order, and multiplications and additions are
not fused, so both devices draw the same image.

Kernels are written so that Numba's simulator runs them too: a compiled function hands Python floats
to its caller there, which are float32 numbers of type float64 until ``np.float32`` takes them back.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from inspect import signature
from typing import Any

import mujoco
import numba.cuda
import numpy as np
from numba.cuda.cudadrv import nvvm
from numpy.typing import NDArray

from knowarm.errors import UserError
from knowarm.world.render.cast import (
    cast_at_geom,
    cast_at_triangle,
    cast_colour,
    cast_smooth_colour,
)
from knowarm.world.render.grid import BITS, TILE, Grid, sample_point
from knowarm.world.render.numeric import FAR, ZERO, Matrix, Vector
from knowarm.world.render.prepare import EXTENT, RECORD, prepare, prepare_light
from knowarm.world.render.raycaster import Raycaster
from knowarm.world.render.tables import MESH

cuda: Any = numba.cuda
"""Its annotations do not know how kernels are written."""

Array = Any
"""A device array."""

THREADS = 128
HIDDEN = -1
"""Kind in the extent of a geom that is not to be drawn."""

# Link-time optimization, numba-cuda's default, would fuse what the compiler was told not to.
_UNFUSED_LINK = {"lto": False} if "lto" in signature(cuda.jit).parameters else {}


def kernel(function: Callable[..., None]) -> Any:
    """Compile a kernel when it is first launched, to be linked as it was compiled."""
    return cuda.jit(function, **_UNFUSED_LINK)


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
    """Set all numbers to a value."""
    index = cuda.grid(1)
    if index < numbers.shape[0]:
        numbers[index] = value


@kernel
def prepare_kernel(
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
    anew: Array,
    wanted: Array,
) -> None:
    """Place one geom of one environment before its camera.

    Args:
        order: (D,) ids of the drawn geoms, the ``fixed`` ones that stand still first.
        fixed: how many these are.
        shape: kind (G,), size (G, 3), glow (G,), middle (G, 3) and half (G, 3) of the geoms.
        own_rgba: (G, 4) the model's colours.
        position: (n, G, 3) world positions.
        matrix: (n, G, 9) row-major rotations from geom to world.
        rgba: (n or 1, G, 4) colours; alpha 0 hides.
        views: (n or 1, 12) cameras.
        lamps: (n or 1, 12) lights.
        grid: the samples.
        record: (n, D, RECORD) to write.
        extent: (n, D, EXTENT) to write; kind ``HIDDEN`` for what is not to be seen.
        anew: (n,) set to 1 where the kept image of the fixed geoms does not serve.
        wanted: (n or 1,) bool; the other environments are not placed.
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
                anew[e] = 1
    own = _nine(matrix[e, g], 0)
    visible, window, origin, frame = prepare(
        shape[0][g], _three(shape[1][g], 0), _three(shape[3][g], 0), _three(shape[4][g], 0),
        _three(position[e, g], 0), own, _three(view, 0), _nine(view, 3), grid,
    )  # fmt: skip
    target, numbers = extent[e, slot], record[e, slot]
    target[0] = shape[0][g] if visible and colour[3] > 0 else HIDDEN
    target[1] = g
    # Tiles instead of samples: the CPU draws whole tiles.
    for i in range(4):
        target[2 + i] = window[i] >> BITS
    lights = _three(lamp, 0), _three(lamp, 3), _three(lamp, 6), _three(lamp, 9)
    sun, colours = prepare_light(_three(colour, 0), shape[2][g], lights, own)
    _write(numbers, 0, origin)
    for i in range(9):
        numbers[3 + i] = frame[i]
    _write(numbers, 12, _three(shape[1][g], 0))
    _write(numbers, 15, sun)
    for i in range(3):
        _write(numbers, 18 + 3 * i, colours[i])


@kernel
def draw_kernel(
    record: Array,
    extent: Array,
    fixed: int,
    anew: Array,
    grid: Grid,
    kept: tuple[Array, Array],
    background: int,
    triangles: tuple[Array, Array, Array, Array],
    wanted: Array,
    out: Array,
) -> None:
    """Draw one pixel of one environment.

    Args:
        record: (n, D, RECORD) as prepared.
        extent: (n, D, EXTENT) as prepared.
        fixed: how many of the D geoms are in the kept image.
        anew: (n,) 1 where they are to be drawn all the same.
        grid: the samples.
        kept: depth and packed colour of the fixed geoms' samples.
        background: packed colour of nothing.
        triangles: ``Meshes.vertex``, ``face``, ``normal`` and ``span``.
        wanted: (n or 1,) bool; the other environments are not drawn.
        out: (n, H, W, 3) uint8 to write.
    """
    index = cuda.grid(1)
    height, width = out.shape[1], out.shape[2]
    e, pixel = index // (height * width), index % (height * width)
    if e >= out.shape[0] or not wanted[min(e, wanted.shape[0] - 1)]:
        return
    j, i = pixel // width, pixel % width
    vertex, face, corner_normal, span = triangles
    samples = grid.mask + 1
    half = samples >> 1
    red, green, blue = half, half, half
    for s in range(samples):
        row = j * samples + s
        sample = sample_point(np.int32(i), np.int32(row), grid)
        x, y = np.float32(sample[0]), np.float32(sample[1])
        depth, value, first = FAR, np.int32(background), 0
        if not anew[e]:
            place = ((i >> BITS) * grid.rows + row) * TILE + (i & (TILE - 1))
            depth, value, first = kept[0][place], kept[1][place], fixed
        winner, winning_face = -1, -1
        nx, ny, nz = ZERO, ZERO, ZERO
        for slot in range(first, extent.shape[1]):
            tiles, numbers = extent[e, slot], record[e, slot]
            if (
                tiles[0] == HIDDEN
                or (i >> BITS) < tiles[2]
                or (i >> BITS) > tiles[3]
                or (row >> BITS) < tiles[4]
                or (row >> BITS) > tiles[5]
            ):
                continue
            origin, frame = _three(numbers, 0), _nine(numbers, 3)
            if tiles[0] == MESH:
                for f in range(span[tiles[1], 2], span[tiles[1], 3]):
                    met = cast_at_triangle(
                        origin, frame, _three(vertex[face[f, 0]], 0),
                        _three(vertex[face[f, 1]], 0), _three(vertex[face[f, 2]], 0), x, y,
                    )  # fmt: skip
                    if np.float32(met[0]) < depth:
                        depth, winner, winning_face = np.float32(met[0]), slot, f
                        nx, ny, nz = _floats(met[1])
            else:
                met = cast_at_geom(tiles[0], origin, frame, _three(numbers, 12), x, y)
                if np.float32(met[0]) < depth:
                    depth, winner = np.float32(met[0]), slot
                    nx, ny, nz = _floats(met[1])
        if winner >= 0:
            numbers = record[e, winner]
            frame, sun = _nine(numbers, 3), _three(numbers, 15)
            colours = _three(numbers, 18), _three(numbers, 21), _three(numbers, 24)
            if extent[e, winner, 0] == MESH:
                normals = corner_normal[winning_face]
                value = cast_smooth_colour(
                    (nx, ny, nz), _three(normals, 0), _three(normals, 3), _three(normals, 6),
                    frame, sun, colours,
                )  # fmt: skip
            else:
                value = cast_colour((nx, ny, nz), frame, sun, colours)
        red += value & 255
        green += (value >> 8) & 255
        blue += (value >> 16) & 255
    out[e, j, i, 0] = red // samples
    out[e, j, i, 1] = green // samples
    out[e, j, i, 2] = blue // samples


class CudaRaycaster:
    """Draws on the GPU what a ``Raycaster`` of the same arguments draws on the CPU.

    Arrays are taken from any library that offers ``__cuda_array_interface__`` (torch, Warp, Numba)
    and are read and written where they lie. Takes the same arguments as ``Raycaster``, less the
    threads.

    Raises:
        UserError: there is no CUDA device, or as ``Raycaster``.
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
        scenery = host.scenery
        meshes = scenery.meshes
        self._height, self._width, self._grid = height, width, host.grid
        self._fixed = len(scenery.fixed)
        self._background = int(scenery.empty[1][0])
        self._order = cuda.to_device(np.concatenate([scenery.fixed, scenery.moving]))
        self._shape = _on_device(
            scenery.kind, scenery.size, scenery.glow, meshes.middle, meshes.half
        )
        self._triangles = _on_device(meshes.vertex, meshes.face, meshes.normal, meshes.span)
        self._kept = _on_device(*scenery.backdrop)
        self._rgba, self._own, self._view, self._lamps = _on_device(
            scenery.rgba, scenery.rgba[None], host.view[None], host.lamps.reshape(1, 12)
        )
        self._everywhere = cuda.to_device(np.ones(1, dtype=np.bool_))
        self._record = self._extent = self._anew = cuda.device_array((0,), dtype=np.int32)

    def render(
        self,
        geom_xpos: Any,
        geom_xmat: Any,
        geom_rgba: Any = None,
        out: Any = None,
        *,
        views: Any = None,
        lamps: Any = None,
        wanted: Any = None,
        stream: Any = 0,
    ) -> Any:
        """Draw a batch; arguments are device arrays shaped as those of ``Raycaster.render``.

        Args:
            geom_xpos: (n, G, 3) positions [m], float32 or float64.
            geom_xmat: (n, G, 9) rotations from geom to world.
            geom_rgba: (n, G, 4) float32 colours, None for the model's.
            out: (n, H, W, 3) uint8 to write into, None for a new Numba device array.
            views: (n, 12) float32 cameras, None for the model's.
            lamps: (n, 12) float32 lights, the rows of ``Raycaster.lamps``; None for the model's.
            wanted: (n,) bool, the environments to draw, whose images alone are written; None
                draws all.
            stream: the Numba stream to launch on, 0 for the default one.

        Returns:
            ``out``. Launches are asynchronous, in the stream's order.
        """
        count, slots = len(geom_xpos), len(self._order)
        if len(self._anew) < count:
            self._record = cuda.device_array((count, slots, RECORD), dtype=np.float32)
            self._extent = cuda.device_array((count, slots, EXTENT), dtype=np.int32)
            self._anew = cuda.device_array((count,), dtype=np.int32)
        if out is None:
            shape = (count, self._height, self._width, 3)
            out = cuda.device_array(shape, dtype=np.uint8)
        own = views is None and lamps is None
        record, extent, anew = self._record[:count], self._extent[:count], self._anew[:count]
        drawn = self._everywhere if wanted is None else _taken(wanted)
        with _unfused():
            fill_kernel[_blocks(count), THREADS, stream](anew, 0 if own else 1)
            prepare_kernel[_blocks(count * slots), THREADS, stream](
                self._order, self._fixed, self._shape, self._rgba, _taken(geom_xpos),
                _taken(geom_xmat), self._own if geom_rgba is None else _taken(geom_rgba),
                self._view if views is None else _taken(views),
                self._lamps if lamps is None else _taken(lamps),
                self._grid, record, extent, anew, drawn,
            )  # fmt: skip
            draw_kernel[_blocks(count * self._height * self._width), THREADS, stream](
                record, extent, self._fixed, anew, self._grid, self._kept, self._background,
                self._triangles, drawn, _taken(out),
            )  # fmt: skip
        return out


def _blocks(threads: int) -> int:
    return -(-threads // THREADS)


def _on_device(*arrays: NDArray[Any]) -> tuple[Array, ...]:
    return tuple(cuda.to_device(np.ascontiguousarray(array)) for array in arrays)


def _taken(array: Any) -> Array:
    """A foreign device array as Numba's own, without a copy and without waiting for its stream."""
    foreign = hasattr(array, "__cuda_array_interface__") and hasattr(cuda, "as_cuda_array")
    return cuda.as_cuda_array(array, sync=False) if foreign else array


@contextmanager
def _unfused() -> Iterator[None]:
    """Have kernels that are compiled in here round after every multiplication, as the CPU does.

    ``cuda.jit`` has no option for it, so the one that NVVM has is set where it is called.
    """
    compile_ir = getattr(nvvm, "compile_ir", None)
    if compile_ir is None:  # the simulator compiles nothing
        yield
        return
    nvvm.compile_ir = partial(compile_ir, fma=False)
    try:
        yield
    finally:
        nvvm.compile_ir = compile_ir
