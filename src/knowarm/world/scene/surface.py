"""Geoms of bodies, and points on their surfaces."""

from collections.abc import Sequence
from itertools import product

import numpy as np
from mujoco import MjData, MjModel, mjtGeom

from knowarm.arrays import Floats, Integers

POINTS = 9  # Along each edge


def geoms_of(model: MjModel, bodies: Sequence[int]) -> Integers:
    """Return the ids of the geoms of bodies."""
    return np.flatnonzero(np.isin(model.geom_bodyid, bodies))


def solid_geoms(model: MjModel, bodies: Sequence[int]) -> list[int]:
    """Return the geoms of bodies that collide, or all where none does."""
    geoms = geoms_of(model, bodies)
    solid = geoms[model.geom_contype[geoms] != 0]
    return (solid if len(solid) else geoms).tolist()


def surface_points(data: MjData, geom: int) -> Floats:
    """Return points along the edges of a mesh, or in the box around another geom, (P, 3) [m]."""
    model = data.model
    if model.geom_type[geom] == mjtGeom.mjGEOM_MESH:
        mesh = model.mesh(model.geom_dataid[geom])
        following = model.mesh_face[mesh.faceadr[0] :]
        faces = following[: mesh.facenum[0]]
        corners = model.mesh_vert[mesh.vertadr[0] :][faces]  # (F, 3, 3)
        share = np.linspace(0, 1, POINTS)[:, None, None, None]
        edges = (1 - share) * corners + share * np.roll(corners, 1, axis=1)
        local = edges.reshape(-1, 3)
    else:
        middle, half = model.geom_aabb[geom].reshape(2, 3)
        line = np.linspace(-1, 1, POINTS)
        grid = list(product(line, repeat=3))
        local = middle + half * np.array(grid)
    to_world = data.geom_xmat[geom].reshape(3, 3)
    return local @ to_world.T + data.geom_xpos[geom]
