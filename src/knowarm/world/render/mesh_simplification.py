"""Level of detail: meshes with as many triangles as an image can show.

A robot's visual meshes have a hundred thousand triangles; an image of 64 x 64 pixels can show few
of them. They are simplified by quadric edge collapses (Garland and Heckbert 1997, of the library
fast-simplification).
"""

from importlib.metadata import version
from typing import NamedTuple

import fast_simplification
import numpy as np
import scipy
from numpy import float32, int32
from numpy.linalg import norm

from knowarm.arrays import Array, Floats, Floats32, Indices
from knowarm.world.cache import cache_file, read_arrays, write_arrays
from knowarm.world.render.numeric import Integers32

FEWEST = 32  # Meshes are not simplified to fewer triangles
WELD = 0.25  # Side of the cells whose vertices are merged before the collapses, in triangles
NEIGHBOURS = 16  # Corners of the full mesh from which a corner takes its normal
CREASE_COSINE = 0.4
"""Below this cosine between a triangle's and a corner's normal there is an edge between them."""

# Part of the cache's key; to be increased with every change of the results
REVISION = 2


class Mesh(NamedTuple):
    """A triangle mesh with normals."""

    vertex: Floats32  # Vertices [m], (V, 3)
    face: Integers32  # Vertices of each triangle, (T, 3)
    normal: Floats32  # Unit normals at each triangle's corners, (T, 3, 3)


def simplified(mesh: Mesh, side_m: float) -> Mesh:
    """Simplify a mesh to triangles of a mean size, or read the result from the cache.

    The side, the root of the mean area [m], is rounded down to a power of the square root of two,
    so that a slightly different camera finds the same file.
    """
    half_powers = np.floor(2 * np.log2(side_m))
    side_m = float(2 ** (half_powers / 2))
    corners = mesh.vertex[mesh.face]
    doubled = _normals(corners.astype(np.float64))
    area = norm(doubled, axis=1).sum() / 2
    count = max(FEWEST, int(area / side_m**2))
    if count >= len(mesh.face):
        return mesh
    file = cache_file("meshes", REVISION, version("fast-simplification"), side_m, *mesh)
    cached = read_arrays(file)
    if cached is not None:
        return Mesh(**cached)  # type: ignore[arg-type]
    result = _simplify(mesh, count, side_m)
    write_arrays(file, result._asdict())
    return result


def merge_vertices(vertex: Array, face: Integers32) -> tuple[Indices, Indices]:
    """Merge equal vertices (V, 3): return the new index of each, (V,), and the triangles of these.

    Triangles of which corners have become one are left out.
    """
    _, index = np.unique(vertex, axis=0, return_inverse=True)
    index = index.reshape(-1)
    merged = index[face]
    is_triangle = (merged != np.roll(merged, 1, axis=1)).all(axis=1)
    return index, merged[is_triangle]


def _simplify(mesh: Mesh, count: int, side_m: float) -> Mesh:
    """Collapse edges until a mesh has about so many triangles."""
    # Edges exist where triangles share a vertex; files store close vertices several times.
    cells = np.round(mesh.vertex / (WELD * side_m))
    cell, faces = merge_vertices(cells, mesh.face)
    faces = faces.astype(int32)
    sums = np.stack([np.bincount(cell, axis) for axis in mesh.vertex.T], axis=1)
    points: Floats = sums / np.bincount(cell)[:, None]
    if len(faces) > count:
        # The library's first threshold has a fixed size, hence lengths in triangles.
        points, faces, *_ = fast_simplification.simplify(
            points / side_m, faces, target_count=count
        )
        points = points * side_m
    if not len(faces):
        return mesh
    normals = _smooth_normals(mesh, points.astype(np.float64)[faces])
    return Mesh(points.astype(float32), faces.astype(int32), normals)


def _normals(corners: Array) -> Array:
    """Return the normals of triangles (T, 3, 3), as long as twice their area."""
    a, b, c = corners.swapaxes(0, 1)
    return np.cross(b - a, c - a)


def unit_normals(corners: Array) -> Array:
    """Return the unit normals (T, 3) of triangles with corners (T, 3, 3)."""
    normal = _normals(corners)
    length = norm(normal, axis=1, keepdims=True)
    return normal / np.maximum(length, 1e-20)


def _smooth_normals(full: Mesh, corners: Floats) -> Floats32:
    """Average the full mesh's normals near each corner (T, 3, 3), those across an edge left out."""
    face_normal = unit_normals(corners)
    # A corner belongs to several sides of the surface; slightly inside, the triangle's own is near.
    inside = 0.85 * corners
    inside += 0.15 * corners.mean(axis=1, keepdims=True)
    points = full.vertex[full.face].reshape(-1, 3)
    neighbours = min(NEIGHBOURS, len(points))
    tree = scipy.spatial.cKDTree(points)
    _, nearest = tree.query(inside, k=neighbours)
    normals = full.normal.reshape(-1, 3)[nearest]
    normals = normals.astype(np.float64)
    cosine = np.einsum("tcki,ti->tck", normals, face_normal)
    weight = np.maximum(cosine - CREASE_COSINE, 0.0)
    mean = np.einsum("tck,tcki->tci", weight, normals)
    length = norm(mean, axis=2, keepdims=True)
    unit = mean / np.maximum(length, 1e-9)
    smooth = np.where(length > 1e-9, unit, face_normal[:, None])
    return smooth.astype(float32)
