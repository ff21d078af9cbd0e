"""Scenery: what a MuJoCo model looks like, as float32 arrays for the ray caster's kernels."""

import math
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from knowarm.errors import UserError, unknown_name
from knowarm.world.render.intersections import MESH, SUPPORTED

DEFAULT_RGBA = (0.5, 0.5, 0.5, 1.0)
"""A geom with this colour takes its material's."""

MIN_NORMAL_COSINE = 0.25
"""Below this cosine between a corner's and its triangle's normal the corner's is replaced."""


class Meshes(NamedTuple):
    """All meshes of a model, concatenated. V vertices, T triangles, G geoms."""

    vertex: NDArray[np.float32]
    """Vertices in the frame of their geom [m], (V, 3)."""

    face: NDArray[np.int32]
    """Vertices of each triangle, (T, 3)."""

    normal: NDArray[np.float32]
    """Unit normals at each triangle's corners, (T, 9)."""

    span: NDArray[np.int32]
    """First and one past the last vertex, first and one past the last triangle of each geom, zero
    for geoms that are not meshes, (G, 4)."""

    winding: NDArray[np.int32]
    """1 for a geom whose mesh is closed with triangles anticlockwise from outside, -1 if clockwise,
    0 if open or not a mesh, (G,)."""

    middle: NDArray[np.float32]
    """Centre of each geom's bounding box in its frame [m], (G, 3)."""

    half: NDArray[np.float32]
    """Half-sizes of that box [m], (G, 3)."""


class Scenery(NamedTuple):
    """The geoms of a model. G geoms, F fixed and M moving ones that are drawn."""

    kind: NDArray[np.int32]
    """Type of each geom, (G,)."""

    size: NDArray[np.float32]
    """``geom_size`` [m], (G, 3)."""

    emission: NDArray[np.float32]
    """Emission of each geom's material, (G,)."""

    meshes: Meshes
    """The triangles of mesh geoms."""

    rgba: NDArray[np.float32]
    """Colour of each geom, its material's where it has none of its own, (G, 4)."""

    fixed: NDArray[np.int32]
    """Ids of the drawn geoms that stand still in every state, (F,)."""

    moving: NDArray[np.int32]
    """Ids of the drawn geoms that can move, (M,)."""


def read_scenery(model: mujoco.MjModel, geom_groups: tuple[int, ...]) -> Scenery:
    """Read the geoms of a model.

    Raises:
        UserError: a geom of a drawn group is of a type that the ray caster cannot draw.
    """
    drawn = np.flatnonzero(np.isin(model.geom_group, geom_groups))
    for g in drawn:
        if model.geom_type[g] not in SUPPORTED:
            raise UserError(
                f"Geom {model.geom(g).name or g!r} is of type "
                f"{mujoco.mjtGeom(model.geom_type[g]).name.removeprefix('mjGEOM_').lower()}, which "
                "the ray caster cannot draw. Allowed are plane, sphere, capsule, ellipsoid, "
                "cylinder, box and mesh: draw it with renderer='opengl', or put it in a "
                "geom group that is not drawn."
            )
    fixed = np.array([_is_fixed(model, b) for b in model.geom_bodyid], dtype=np.bool_)
    emission = np.zeros(model.ngeom, dtype=np.float32)
    has_material = model.geom_matid >= 0
    emission[has_material] = model.mat_emission[model.geom_matid[has_material]]
    return Scenery(
        kind=model.geom_type.astype(np.int32),
        size=model.geom_size.astype(np.float32),
        emission=emission,
        meshes=_read_meshes(model),
        rgba=_geom_colours(model),
        fixed=drawn[fixed[drawn]].astype(np.int32),
        moving=drawn[~fixed[drawn]].astype(np.int32),
    )


def read_view(
    model: mujoco.MjModel, data: mujoco.MjData, camera: int | str
) -> tuple[NDArray[np.float32], float]:
    """Read a perspective camera that stands still.

    Args:
        model: the model.
        data: with the poses of cameras computed.
        camera: name or id.

    Returns:
        Position [m] and row-major rotation from camera to world, (12,), and tan(fovy / 2).

    Raises:
        UserError: there is no camera of this name or id, or it is orthographic or can move.
    """
    names = [model.camera(i).name for i in range(model.ncam)]
    if isinstance(camera, str):
        if camera not in names:
            raise unknown_name("camera", camera, names)
        camera = names.index(camera)
    if not 0 <= camera < model.ncam:
        raise UserError(f"Camera {camera} does not exist; the model has {model.ncam}, from 0.")
    shown = names[camera] or camera
    if not _is_fixed(model, model.cam_bodyid[camera]) or model.cam_mode[camera] != 0:
        raise UserError(
            f"Camera {shown!r} moves with a body; the ray caster needs a camera that stands still: "
            "attach it to the world with mode 'fixed'."
        )
    if model.cam_projection[camera] != mujoco.mjtProjection.mjPROJ_PERSPECTIVE or np.any(
        model.cam_sensorsize[camera]
    ):
        raise UserError(
            f"Camera {shown!r} is orthographic or has a sensor size; the ray caster needs a "
            "perspective camera given by fovy."
        )
    view = np.concatenate([data.cam_xpos[camera], data.cam_xmat[camera].reshape(9)])
    return view.astype(np.float32), math.tan(math.radians(model.cam_fovy[camera]) / 2)


def read_lamps(model: mujoco.MjModel, data: mujoco.MjData) -> NDArray[np.float32]:
    """Read a model's lights.

    Returns:
        (4, 3): sum of ambient colours, diffuse colours of headlight and directional light, and the
        unit vector towards the latter, world.

    Raises:
        UserError: there are more lights than a headlight and a directional light.
    """
    lamps = np.zeros((4, 3), dtype=np.float32)
    head = model.vis.headlight
    if head.active:
        lamps[0] += head.ambient
        lamps[1] = head.diffuse
    active = np.flatnonzero(model.light_active)
    if len(active) > 1 or any(
        model.light_type[i] != mujoco.mjtLightType.mjLIGHT_DIRECTIONAL for i in active
    ):
        raise UserError(
            "The ray caster supports a headlight and at most one directional light; the model has "
            f"{len(active)} lights. Make the main one directional and switch the others off."
        )
    for i in active:
        lamps[0] += model.light_ambient[i]
        lamps[2] = model.light_diffuse[i]
        lamps[3] = -data.light_xdir[i]
    return lamps


def _is_fixed(model: mujoco.MjModel, body: int) -> bool:
    """Tell whether a body is permanently welded to the world (a mocap body is not)."""
    return bool(model.body_weldid[body] == 0 and model.body_mocapid[model.body_rootid[body]] < 0)


def _geom_colours(model: mujoco.MjModel) -> NDArray[np.float32]:
    """Return the colours as MuJoCo draws them, (G, 4): the geom's own, or its material's."""
    colours = model.geom_rgba.astype(np.float32)
    default = (model.geom_rgba == np.array(DEFAULT_RGBA, dtype=np.float32)).all(axis=1)
    from_material = (model.geom_matid >= 0) & default
    colours[from_material] = model.mat_rgba[model.geom_matid[from_material]]
    return colours


def _read_meshes(model: mujoco.MjModel) -> Meshes:
    """Read the triangles of all mesh geoms."""
    span = np.zeros((model.ngeom, 4), dtype=np.int32)
    winding = np.zeros(model.ngeom, dtype=np.int32)
    for g in np.flatnonzero(model.geom_type == MESH):
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
        normal=_plausible_normals(normals, vertices[faces]).reshape(-1, 9),
        span=span,
        winding=winding,
        middle=model.geom_aabb[:, :3].astype(np.float32),
        half=model.geom_aabb[:, 3:].astype(np.float32),
    )


def _winding(model: mujoco.MjModel, mesh: int) -> int:
    """Return the orientation of a closed mesh's triangles (see ``Meshes``), 0 for an open mesh."""
    first = model.mesh_vertadr[mesh]
    vertices = model.mesh_vert[first : first + model.mesh_vertnum[mesh]].astype(np.float64)
    first = model.mesh_faceadr[mesh]
    faces = model.mesh_face[first : first + model.mesh_facenum[mesh]].astype(np.int64)
    # Corners at one place are one corner, even if they are vertices with different normals.
    place = np.unique(vertices, axis=0, return_inverse=True)[1].reshape(-1)[faces]
    place = place[(place != np.roll(place, 1, axis=1)).all(axis=1)]
    edges = np.concatenate([place[:, [0, 1]], place[:, [1, 2]], place[:, [2, 0]]])
    forward = edges[:, 0] * len(vertices) + edges[:, 1]
    backward = edges[:, 1] * len(vertices) + edges[:, 0]
    if len(np.unique(forward)) < len(forward) or not np.array_equal(
        np.sort(forward), np.sort(backward)
    ):
        return 0
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return int(np.sign(np.sum(a * np.cross(b, c))))


def _plausible_normals(
    normals: NDArray[np.float32], corners: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Replace corner normals (T, 3, 3) that deviate from their triangle's by the triangle's own.

    MuJoCo gives meshes without faces the triangles of their hull, and normals that do not fit.
    """
    own = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    own /= np.maximum(np.linalg.norm(own, axis=1, keepdims=True), 1e-20)
    deviates = (normals * own[:, None]).sum(axis=2) < MIN_NORMAL_COSINE
    return np.where(deviates[:, :, None], own[:, None], normals).astype(np.float32)
