"""Level of detail: meshes simplified to what an image can show.

A robot's visual meshes have a hundred thousand triangles; an image of 64 x 64 pixels can show few
of them. Each connected part of a mesh is simplified by quadric edge collapses (Garland and Heckbert
1997, of the library fast-simplification), as far as its surface stays within a tolerance, which is
measured after the fact and not estimated.
"""

from importlib.metadata import version
from typing import Any, NamedTuple

import fast_simplification
import numpy as np
import scipy
from numpy.typing import NDArray

from knowarm.world.cache import cache_file, read_arrays, write_arrays
from knowarm.world.render.deviation import Surface, deviation

FEWEST = 32
"""Parts with fewer triangles are kept as they are."""

WELDS = (0.0, 0.5, 1.5)
"""Distances within which vertices are merged before the collapses, in tolerances."""

SEARCH_STEPS = 9
"""Numbers of collapses tried per part and weld."""

NEIGHBOURS = 16
"""Corners of the full mesh from which a corner takes its normal."""

CREASE_COSINE = 0.4
"""Below this cosine between a triangle's and a corner's normal there is an edge between them."""

REVISION = 1
"""Part of the cache's key; to be increased with every change of the results."""

Part = tuple[NDArray[np.float64], NDArray[np.int64]]
"""Vertices (V, 3) and triangles (T, 3)."""


class Mesh(NamedTuple):
    """A triangle mesh with normals."""

    vertex: NDArray[np.float32]
    """Vertices [m], (V, 3)."""

    face: NDArray[np.int32]
    """Vertices of each triangle, (T, 3)."""

    normal: NDArray[np.float32]
    """Unit normals at each triangle's corners, (T, 3, 3)."""


def simplified(mesh: Mesh, tolerance_m: float) -> Mesh:
    """Simplify a mesh, or read the result from the cache.

    The tolerance is rounded down to a power of the square root of two, so that a slightly different
    camera finds the same file.

    Args:
        mesh: what to simplify.
        tolerance_m: largest distance between the two surfaces [m].
    """
    if len(mesh.face) <= FEWEST or not tolerance_m > 0:
        return mesh
    tolerance_m = float(2 ** (np.floor(2 * np.log2(tolerance_m)) / 2))
    file = cache_file("meshes", REVISION, version("fast-simplification"), tolerance_m, *mesh)
    found = _sound_mesh(read_arrays(file))
    if found is None:
        found = simplify(mesh, tolerance_m)
        write_arrays(file, found._asdict())
    return found


def _sound_mesh(arrays: dict[str, Any] | None) -> Mesh | None:
    """Return the mesh of a file of the cache; None if there is no sound one."""
    if arrays is None or arrays.keys() != set(Mesh._fields):
        return None
    mesh = Mesh(**arrays)
    sound = (
        [a.dtype for a in mesh] == [np.float32, np.int32, np.float32]
        and mesh.vertex.ndim == mesh.face.ndim == 2
        and mesh.vertex.shape[1] == mesh.face.shape[1] == 3
        and mesh.normal.shape == (len(mesh.face), 3, 3)
        and len(mesh.face) > 0
        and 0 <= mesh.face.min() <= mesh.face.max() < len(mesh.vertex)
    )
    return mesh if sound else None


def simplify(mesh: Mesh, tolerance_m: float) -> Mesh:
    """Simplify a mesh so that its surface moves by at most a tolerance [m]."""
    whole = _weld(mesh.vertex.astype(np.float64), mesh.face.astype(np.int64), 0.0)
    parts = [_simplify_part(part, tolerance_m) for part in _parts(whole)]
    # A part smaller than the tolerance is invisible, unless the mesh has no other.
    sizes = [
        float(np.ptp(vertices[faces].reshape(-1, 3), axis=0).max()) for vertices, faces in parts
    ]
    kept = [part for part, size in zip(parts, sizes, strict=True) if size > tolerance_m]
    vertices, faces = _join(kept or parts)
    if not 0 < len(faces) < len(mesh.face):
        return mesh
    return Mesh(
        vertices.astype(np.float32), faces.astype(np.int32), _normals(mesh, vertices[faces])
    )


def _weld(vertices: NDArray[np.float64], faces: NDArray[np.int64], distance: float) -> Part:
    """Merge vertices that fall into one cell of a grid, and drop what collapses."""
    places = np.round(vertices / distance).astype(np.int64) if distance > 0 else vertices
    place = np.unique(places, axis=0, return_inverse=True)[1].reshape(-1)
    count = np.bincount(place)
    merged = np.stack([np.bincount(place, vertices[:, k]) for k in range(3)], axis=1)
    return merged / count[:, None], _sound(place[faces])


def _sound(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Drop triangles with two equal corners and copies of others."""
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)[1]
    return faces[np.sort(first)]


def _parts(whole: Part) -> list[Part]:
    """Split a mesh into its connected parts; those of few triangles stay together."""
    vertices, faces = whole
    if not len(faces):
        return []
    edges = np.concatenate([faces[:, :2], faces[:, 1:]])
    ones = np.ones(len(edges), dtype=np.int8)
    graph = scipy.sparse.coo_array((ones, (edges[:, 0], edges[:, 1])), shape=(len(vertices),) * 2)
    label = scipy.sparse.csgraph.connected_components(graph, directed=False)[1][faces[:, 0]]
    label, size = np.unique(label, return_inverse=True, return_counts=True)[1:]
    label = np.where(size[label] > FEWEST, label, -1)
    order = np.argsort(label, kind="stable")
    cuts = np.flatnonzero(np.diff(label[order])) + 1
    return [_compact(vertices, group) for group in np.split(faces[order], cuts)]


def _compact(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Part:
    """Drop the vertices that no triangle uses."""
    used, place = np.unique(faces, return_inverse=True)
    return vertices[used], place.reshape(-1, 3)


def _join(parts: list[Part]) -> Part:
    """Concatenate parts to one mesh."""
    if not parts:
        return np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
    first = np.cumsum([0] + [len(vertices) for vertices, _ in parts[:-1]])
    return (
        np.concatenate([vertices for vertices, _ in parts]),
        np.concatenate([faces + start for (_, faces), start in zip(parts, first, strict=True)]),
    )


def _simplify_part(part: Part, tolerance_m: float) -> Part:
    """Return the coarsest version of a connected part that stays within the tolerance."""
    if len(part[1]) <= FEWEST:
        return part
    full, best = Surface(*part), part
    for weld in WELDS:
        welded = _weld(*part, weld * tolerance_m)
        if len(welded[1]):
            best = _collapse(welded, full, best, tolerance_m)
    return _compact(*best)


def _collapse(part: Part, full: Surface, best: Part, tolerance_m: float) -> Part:
    """Search the number of edge collapses after which a part is coarsest within the tolerance.

    Returns:
        The coarsest version found, or ``best`` if it has fewer triangles.
    """
    faces = part[1]
    # The library's thresholds grow with its passes; in units of the tolerance, they reach it.
    fenced, all_faces = _fence(*part)
    points, all_faces = fenced / tolerance_m, all_faces.astype(np.int32)
    collapses = fast_simplification.simplify(
        points, all_faces, target_count=4, agg=6.0, return_collapses=True
    )[2]
    enough, too_many, count = 0, len(collapses) + 1, len(collapses)
    for _ in range(SEARCH_STEPS):
        moved, _, place = fast_simplification.replay_simplification(
            points, all_faces, collapses[:count]
        )
        # Each triangle that is left is one of the part's, with its corners moved.
        left = _sound(place[faces].astype(np.int64))
        vertices = np.asarray(moved, dtype=np.float64) * tolerance_m
        near = len(left) > 0 and (
            len(left) >= len(best[1])
            or deviation(full, Surface(vertices, left), tolerance_m) <= tolerance_m
        )
        if near and len(left) < len(best[1]):
            best = vertices, left
        if near:
            enough = count
        else:
            too_many = count
        # Bisect the logarithm of what remains to collapse.
        rest = (len(collapses) + 1 - enough) * (len(collapses) + 2 - too_many)
        count = len(collapses) + 1 - round(rest**0.5)
        if not enough < count < too_many:
            break
    return best


def _fence(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Part:
    """Add a triangle perpendicular to the surface at each open edge, after the others.

    Collapses along an open edge cost nothing in a plane, and would consume a flat part from its
    border. With a fence, moving the border sideways has a cost.
    """
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    _, first, count = np.unique(
        np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True
    )
    open_edges = first[count == 1]
    a, b = vertices[edges[open_edges]].transpose(1, 0, 2)
    corner = vertices[faces[open_edges % len(faces)]]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-20)
    posts = (a + b) / 2 + normal * np.linalg.norm(a - b, axis=1, keepdims=True)
    added = len(vertices) + np.arange(len(posts))
    fence = np.concatenate([edges[open_edges][:, ::-1], added[:, None]], axis=1)
    return np.concatenate([vertices, posts]), np.concatenate([faces, fence])


def _normals(full: Mesh, corners: NDArray[np.float64]) -> NDArray[np.float32]:
    """Average the full mesh's normals near each corner (T, 3, 3) of a simplified mesh.

    Normals across an edge of the surface do not count. The two sides of a thin wall can become one
    triangle, or change places: both then face away from the middle of the mesh.
    """
    own = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    own /= np.maximum(np.linalg.norm(own, axis=1, keepdims=True), 1e-20)
    # A corner belongs to several sides of the surface; slightly inside, the triangle's own is near.
    inside = 0.85 * corners + 0.15 * corners.mean(axis=1, keepdims=True)
    points = full.vertex[full.face].reshape(-1, 3)
    count = min(NEIGHBOURS, len(points))
    near = scipy.spatial.cKDTree(points).query(inside, k=count)[1].reshape(*inside.shape[:2], count)
    normals = full.normal.reshape(-1, 3)[near].astype(np.float64)
    cosine = np.einsum("tcki,ti->tck", normals, own)
    is_wall = (cosine.max(axis=(1, 2)) > CREASE_COSINE) & (cosine.min(axis=(1, 2)) < -CREASE_COSINE)
    outward = corners.mean(axis=1) - (full.vertex.max(axis=0) + full.vertex.min(axis=0)) / 2
    sign = np.where(is_wall & ((own * outward).sum(axis=1) < 0), -1.0, 1.0)[:, None]
    own, cosine = own * sign, cosine * sign[..., None]
    weight = np.maximum(cosine - CREASE_COSINE, 0.0)
    mean = np.einsum("tck,tcki->tci", weight, normals)
    length = np.linalg.norm(mean, axis=2, keepdims=True)
    blended = np.where(length > 1e-9, mean / np.maximum(length, 1e-9), own[:, None])
    return np.asarray(blended, dtype=np.float32)
