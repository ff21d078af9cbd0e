"""Poses and colours of a batch go in; pictures come out, on one CPU thread."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from knowarm.world.raycast.draw import draw_geom
from knowarm.world.raycast.numeric import FAR, Grid, Look, Matrix, Planes, Vector


@njit(error_model="numpy")
def triple(array: NDArray[np.float32], i: int) -> Vector:
    """Row of three numbers as a tuple."""
    return np.float32(array[i, 0]), np.float32(array[i, 1]), np.float32(array[i, 2])


@njit(error_model="numpy")
def nine(array: NDArray[np.float32], i: int) -> Matrix:
    """Row of nine numbers as a tuple."""
    return (
        np.float32(array[i, 0]), np.float32(array[i, 1]), np.float32(array[i, 2]),
        np.float32(array[i, 3]), np.float32(array[i, 4]), np.float32(array[i, 5]),
        np.float32(array[i, 6]), np.float32(array[i, 7]), np.float32(array[i, 8]),
    )  # fmt: skip


@njit(error_model="numpy")
def draw_list(
    geoms: NDArray[np.int32],
    positions: NDArray[np.float32],
    matrices: NDArray[np.float32],
    rgba: NDArray[np.float32],
    view: NDArray[np.float32],
    lamps: NDArray[np.float32],
    look: Look,
    grid: Grid,
    planes: Planes,
) -> None:
    """Draw the visible geoms of a list, in its order, over what the planes hold."""
    kind, size, glow = look
    light = (triple(lamps, 0), triple(lamps, 1), triple(lamps, 2), triple(lamps, 3))
    for g in geoms:
        if rgba[g, 3] > 0:
            draw_geom(
                kind[g], triple(size, g), triple(positions, g), nine(matrices, g), view,
                triple(rgba, g), glow[g], light, grid, planes, np.int32(g),
            )  # fmt: skip


@njit(error_model="numpy")
def _as_cached(
    geoms: NDArray[np.int32], rgba: NDArray[np.float32], expected: NDArray[np.float32]
) -> bool:
    """Whether the fixed geoms look as in the cached picture."""
    for g in geoms:
        for c in range(4):
            if rgba[g, c] != expected[g, c]:
                return False
    return True


@njit(error_model="numpy")
def unpack(colour: NDArray[np.int32], out: NDArray[np.uint8]) -> None:
    """Write packed colours (H, W or wider) into a picture (H, W, 3) uint8."""
    height, width = out.shape[0], out.shape[1]
    for j in range(height):
        for i in range(width):
            packed = colour[j, i]
            out[j, i, 0] = packed & 255
            out[j, i, 1] = (packed >> 8) & 255
            out[j, i, 2] = (packed >> 16) & 255


@njit(error_model="numpy", nogil=True, cache=True)
def render_range(
    start: int,
    stop: int,
    positions: NDArray[np.float32],
    matrices: NDArray[np.float32],
    rgba: NDArray[np.float32],
    views: NDArray[np.float32],
    lamps: NDArray[np.float32],
    look: Look,
    fixed: NDArray[np.int32],
    moving: NDArray[np.int32],
    own_rgba: NDArray[np.float32],
    cached: Planes,
    grid: Grid,
    background: np.int32,
    planes: Planes,
    out: NDArray[np.uint8],
) -> None:
    """Draw environments start .. stop - 1.

    Args:
        start: first environment.
        stop: one past the last.
        positions: (n, G, 3) world positions of geoms.
        matrices: (n, G, 9) row-major rotations from geom to world.
        rgba: (n or 1, G, 4) float32; alpha 0 hides.
        views: (n or 1, 12) float32 cameras; with one for all, the cached picture serves.
        lamps: (n or 1, 4, 3) float32, as in ``Tables.lamps``; likewise.
        look: kind (G,), size (G, 3) and glow (G,).
        fixed: ids of geoms in the cached picture.
        moving: ids of the others.
        own_rgba: (G, 4) the colours of the cached picture.
        cached: planes of the cached picture.
        grid: as in ``draw_geom``.
        background: packed colour where nothing is.
        planes: planes to draw in.
        out: (n, H, W, 3) uint8.
    """
    shared = (views.shape[0] == 1) & (lamps.shape[0] == 1)
    for e in range(start, stop):
        colours = rgba[min(e, rgba.shape[0] - 1)]
        view, light = views[min(e, views.shape[0] - 1)], lamps[min(e, lamps.shape[0] - 1)]
        if shared and _as_cached(fixed, colours, own_rgba):
            planes[0][:] = cached[0]
            planes[1][:] = cached[1]
            planes[2][:] = cached[2]
        else:
            planes[0][:] = FAR
            planes[1][:] = -1
            planes[2][:] = background
            draw_list(fixed, positions[e], matrices[e], colours, view, light, look, grid, planes)
        draw_list(moving, positions[e], matrices[e], colours, view, light, look, grid, planes)
        unpack(planes[2], out[e])
