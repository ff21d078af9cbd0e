"""Deviation of one triangle mesh from another: the Hausdorff distance of their surfaces."""

import math

import numpy as np
import scipy
from numba import njit
from numpy.typing import NDArray

from knowarm.world.render.numeric import cached_njit

SAMPLES = 4000
"""Most points of a surface whose distance to the other is measured."""


class Surface:
    """A triangle mesh with what the distance to it needs.

    Args:
        vertices: (V, 3) float64 [m].
        faces: (T, 3) vertices of each triangle, T > 0.

    Attributes:
        points: (n, 3) vertices and centroids, at most ``SAMPLES``, evenly chosen.
    """

    def __init__(self, vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> None:
        self.corners = np.ascontiguousarray(vertices[faces], dtype=np.float64)
        self.centre = self.corners.mean(axis=1)
        offset = self.corners - self.centre[:, None]
        self.radius = np.sqrt((offset**2).sum(axis=2).max(axis=1))
        used = vertices[np.unique(faces)]
        points = np.concatenate([used, self.centre])
        chosen = np.linspace(0, len(points) - 1, min(SAMPLES, len(points))).astype(np.intp)
        self.points = np.ascontiguousarray(points[chosen], dtype=np.float64)
        self._tree = scipy.spatial.cKDTree(used)

    def farthest(self, points: NDArray[np.float64], limit: float) -> float:
        """Return the largest distance of points (n, 3) to this surface [m].

        Beyond ``limit`` [m] the search stops: the result is then only known to be larger.
        """
        # The distance to the nearest vertex is an upper bound that skips most triangles.
        bound = self._tree.query(points)[0]
        return float(_farthest(points, bound, self.corners, self.centre, self.radius, limit))


def deviation(one: Surface, other: Surface, limit: float) -> float:
    """Return the Hausdorff distance of two surfaces [m], from their sampled points.

    Beyond ``limit`` [m] the result is only known to be larger.
    """
    there = other.farthest(one.points, limit)
    return there if there > limit else max(there, one.farthest(other.points, limit))


@cached_njit
def _farthest(
    points: NDArray[np.float64],
    bound: NDArray[np.float64],
    corners: NDArray[np.float64],
    centre: NDArray[np.float64],
    radius: NDArray[np.float64],
    limit: float,
) -> float:
    """Return the largest distance of points to triangles, given upper bounds of the distances."""
    worst = 0.0
    for i in range(points.shape[0]):
        nearest, p = bound[i], points[i]
        for f in range(corners.shape[0]):
            if nearest <= worst:
                break
            x, y, z = p[0] - centre[f, 0], p[1] - centre[f, 1], p[2] - centre[f, 2]
            reach = nearest + radius[f]
            if x * x + y * y + z * z < reach * reach:
                nearest = min(nearest, _distance(p, corners[f]))
        worst = max(worst, nearest)
        if worst > limit:
            break
    return worst


@njit(error_model="numpy")
def _distance(p: NDArray[np.float64], corners: NDArray[np.float64]) -> float:
    """Return the distance of a point to a triangle (Ericson 2005, section 5.1.5)."""
    a, b, c = corners[0], corners[1], corners[2]
    ab, ac, ap = b - a, c - a, p - a
    d1, d2 = _dot(ab, ap), _dot(ac, ap)
    if d1 <= 0 and d2 <= 0:
        return _length(ap)
    bp = p - b
    d3, d4 = _dot(ab, bp), _dot(ac, bp)
    if d3 >= 0 and d4 <= d3:
        return _length(bp)
    cp = p - c
    d5, d6 = _dot(ab, cp), _dot(ac, cp)
    if d6 >= 0 and d5 <= d6:
        return _length(cp)
    on_ab, on_ac, on_bc = d1 * d4 - d3 * d2, d5 * d2 - d1 * d6, d3 * d6 - d5 * d4
    if on_ab <= 0 and d1 >= 0 and d3 <= 0:
        return _length(ap - ab * (d1 / (d1 - d3) if d1 > d3 else 0.0))
    if on_ac <= 0 and d2 >= 0 and d6 <= 0:
        return _length(ap - ac * (d2 / (d2 - d6) if d2 > d6 else 0.0))
    along, back = d4 - d3, d5 - d6
    if on_bc <= 0 and along >= 0 and back >= 0:
        return _length(bp - (c - b) * (along / (along + back) if along + back > 0 else 0.0))
    total = on_ab + on_ac + on_bc
    return _length(ap - ab * (on_ac / total) - ac * (on_ab / total))


@njit(error_model="numpy")
def _dot(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(error_model="numpy")
def _length(v: NDArray[np.float64]) -> float:
    return math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
