"""A MuJoCo model goes in; the triangles of its meshes come out as arrays for the drawing loops."""

from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

LEANING = 0.25
"""Cosine between a corner's and its triangle's normal below which the former is not believed."""


class Meshes(NamedTuple):
    """All meshes of a model one after the other. V vertices, T triangles, G geoms."""

    vertex: NDArray[np.float32]
    """Vertices in the frame of their geom [m], (V, 3)."""

    face: NDArray[np.int32]
    """Vertices of each triangle, (T, 3)."""

    normal: NDArray[np.float32]
    """Unit normals at each triangle's corners, (T, 9)."""

    span: NDArray[np.int32]
    """First and one past the last vertex, first and one past the last triangle of each geom, zero
    for geoms that are no mesh, (G, 4)."""

    winding: NDArray[np.int32]
    """1 for a geom whose mesh is closed with triangles anticlockwise from outside, -1 if clockwise,
    0 if open or no mesh, (G,)."""

    middle: NDArray[np.float32]
    """Middle of each geom's bounding box in its frame [m], (G, 3)."""

    half: NDArray[np.float32]
    """Half-sizes of that box [m], (G, 3)."""


def read_meshes(model: mujoco.MjModel) -> Meshes:
    """Read the triangles of all mesh geoms."""
    span = np.zeros((model.ngeom, 4), dtype=np.int32)
    winding = np.zeros(model.ngeom, dtype=np.int32)
    for g in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH):
        mesh = model.geom_dataid[g]
        vertex, face = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
        span[g] = (
            vertex, vertex + model.mesh_vertnum[mesh], face, face + model.mesh_facenum[mesh]
        )  # fmt: skip
        winding[g] = _winding(model, mesh)
    first_vertex = np.repeat(model.mesh_vertadr, model.mesh_facenum)[:, None]
    first_normal = np.repeat(model.mesh_normaladr, model.mesh_facenum)[:, None]
    vertices = model.mesh_vert.reshape(-1, 3).astype(np.float32)
    faces = (model.mesh_face.reshape(-1, 3) + first_vertex).astype(np.int32)
    normals = model.mesh_normal.reshape(-1, 3)[model.mesh_facenormal.reshape(-1, 3) + first_normal]
    return Meshes(
        vertex=vertices,
        face=faces,
        normal=_sound_normals(normals, vertices[faces]).reshape(-1, 9),
        span=span,
        winding=winding,
        middle=model.geom_aabb[:, :3].astype(np.float32),
        half=model.geom_aabb[:, 3:].astype(np.float32),
    )


def _winding(model: mujoco.MjModel, mesh: int) -> int:
    """Sense of rotation of a closed mesh's triangles, 0 for an open mesh."""
    first = model.mesh_vertadr[mesh]
    vertices = model.mesh_vert[first : first + model.mesh_vertnum[mesh]].astype(np.float64)
    first = model.mesh_faceadr[mesh]
    faces = model.mesh_face[first : first + model.mesh_facenum[mesh]].astype(np.int64)
    # Corners at one place are one corner, though they may be vertices with different normals.
    place = np.unique(vertices, axis=0, return_inverse=True)[1].reshape(-1)[faces]
    place = place[(place != np.roll(place, 1, axis=1)).all(axis=1)]
    edges = np.concatenate([place[:, [0, 1]], place[:, [1, 2]], place[:, [2, 0]]])
    there = edges[:, 0] * len(vertices) + edges[:, 1]
    back = edges[:, 1] * len(vertices) + edges[:, 0]
    if len(np.unique(there)) < len(there) or not np.array_equal(np.sort(there), np.sort(back)):
        return 0
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return int(np.sign(np.sum(a * np.cross(b, c))))


def _sound_normals(
    normals: NDArray[np.float32], corners: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Replace corner normals (T, 3, 3) that lean away from their triangle by the triangle's own.

    MuJoCo gives meshes without faces the triangles of their hull, and normals that do not fit.
    """
    own = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    own /= np.maximum(np.linalg.norm(own, axis=1, keepdims=True), 1e-20)
    leans = (normals * own[:, None]).sum(axis=2) < LEANING
    return np.where(leans[:, :, None], own[:, None], normals).astype(np.float32)
