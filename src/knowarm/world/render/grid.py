"""A field of view and a image size go in; the sample points of the image come out.

A image of H x W pixels with S samples a pixel is a field of H * S rows of W samples. Rows are
evenly spaced, ``pixel / S`` apart; with four samples every other row is shifted sideways so that a
pixel's samples have four different heights and four different sideways places (a rotated grid):

    row 4j        . x . .
    row 4j + 1    . . . x
    row 4j + 2    x . . .
    row 4j + 3    . . x .

Samples are stored strip by strip, a strip being ``TILE`` columns: (strips, rows, TILE) numbers, so
that tiles above each other are one run of memory.
"""

from typing import NamedTuple

import numpy as np

from knowarm.world.render.numeric import scalar

TILE, BITS = 4, 2
"""Side of a tile of samples, a power of two, and that power."""

ANTIALIASING = 4
"""Samples a pixel with anti-aliasing."""


class Grid(NamedTuple):
    """Where the samples lie, in image coordinates X = x / -z, Y = y / -z before the camera."""

    left: np.float32
    """X of the middle of the first pixel."""

    top: np.float32
    """Y of the first row."""

    pixel: np.float32
    """Width of a pixel."""

    step: np.float32
    """Distance between rows, ``pixel / S``."""

    mask: np.int32
    """S - 1; row & mask is the sample's number within its pixel."""

    shift: np.float32
    """Sideways place of sample 0 relative to the middle of the pixel."""

    advance: np.float32
    """Sideways way from a sample to the next."""

    back: np.float32
    """Sideways way back before sample 2, so that sample 3 stays inside the pixel."""

    reach: np.float32
    """Largest sideways distance of a sample from the middle, in pixels."""

    strips: np.int32
    """Strips of ``TILE`` columns that hold the image."""

    rows: np.int32
    """Rows of samples, a multiple of ``TILE``."""


def make_grid(width: int, height: int, half_height: float, samples: int) -> Grid:
    """Lay out 1 or ``ANTIALIASING`` samples a pixel; the image's half height is at depth 1."""
    pixel = 2 * half_height / height
    # In quarters of a pixel: sample s of four lies at 2 s - .5, less 5 from sample 2 on.
    shift, advance, back = {1: (0, 0, 0), ANTIALIASING: (-0.5, 2, 5)}[samples]
    return Grid(
        left=np.float32((1 - width) / 2 * pixel),
        top=np.float32(half_height - pixel / samples / 2),
        pixel=np.float32(pixel),
        step=np.float32(pixel / samples),
        mask=np.int32(samples - 1),
        shift=np.float32(shift * pixel / 4),
        advance=np.float32(advance * pixel / 4),
        back=np.float32(back * pixel / 4),
        reach=np.float32({1: 0.0, ANTIALIASING: 0.375}[samples]),
        strips=np.int32(-(-width // TILE)),
        rows=np.int32(-(-height * samples // TILE) * TILE),
    )


@scalar
def sample_point(column: np.int32, row: np.int32, grid: Grid) -> tuple[np.float32, np.float32]:
    """X and Y of the sample in a pixel column and a row of samples."""
    s = np.int32(row & grid.mask)
    half = np.int32(s >> np.int32(1))
    aside = grid.shift + np.float32(s) * grid.advance - np.float32(half) * grid.back
    x = grid.left + np.float32(column) * grid.pixel + aside
    return x, grid.top - np.float32(row) * grid.step
