"""Scenery: what a MuJoCo model looks like, as float32 arrays for the ray caster's kernels."""

import math
from typing import NamedTuple

import numpy as np
from mujoco import MjData, MjModel, mjtGeom, mjtLightType
from numpy import float32, int32

from knowarm.arrays import Floats, Floats32, Integers, Mask
from knowarm.errors import UserError, unknown_name
from knowarm.world.render.intersections import MESH, SUPPORTED
from knowarm.world.render.mesh_simplification import (
    Mesh,
    merge_vertices,
    simplified,
    unit_normals,
)
from knowarm.world.render.numeric import Integers32
from knowarm.world.scene.appearance import geom_colours

NO_MESH = Mesh(
    np.empty((0, 3), float32),
    np.empty((0, 3), int32),
    np.empty((0, 3, 3), float32),
)
MIN_NORMAL_COSINE = 0.25
"""Below this cosine between a corner's and its triangle's normal the corner's is replaced."""


class Meshes(NamedTuple):
    """All meshes of a model, concatenated. V vertices, T triangles, G geoms."""

    vertex: Floats32  # Vertices in the frame of their geom [m], (V, 3)
    face: Integers32  # Vertices of each triangle, (T, 3)
    normal: Floats32  # Unit normals at each triangle's corners, (T, 9)
    # First and one past the last vertex, first and one past the last triangle of each geom, zero
    # for geoms that are not meshes, (G, 4)
    span: Integers32
    # 1 for a geom whose mesh is closed with triangles anticlockwise from outside, -1 if clockwise,
    # 0 if open or not a mesh, (G,)
    winding: Integers32
    middle: Floats32  # Centre of each geom's bounding box in its frame [m], (G, 3)
    half: Floats32  # Half-sizes of that box [m], (G, 3)


class Scenery(NamedTuple):
    """The geoms of a model. G geoms, F fixed and M moving ones that are drawn."""

    kind: Integers32  # Type of each geom, (G,)
    size: Floats32  # ``geom_size`` [m], (G, 3)
    emission: Floats32  # Emission of each geom's material, (G,)
    meshes: Meshes  # The triangles of mesh geoms
    # Colour of each geom, its material's where it has none of its own, (G, 4)
    rgba: Floats32
    fixed: Integers32  # Ids of the drawn geoms that stand still in every state, (F,)
    moving: Integers32  # Ids of the drawn geoms that can move, (M,)


def read_scenery(
    model: MjModel,
    geom_groups: tuple[int, ...],
    triangle_m: Floats | None = None,
) -> Scenery:
    """Read the geoms of a model in some groups.

    ``triangle_m`` is the size to which the triangles of each mesh geom are enlarged [m], (G,).
    """
    drawn = np.flatnonzero(np.isin(model.geom_group, geom_groups))
    for g in drawn:
        kind = model.geom_type[g]
        if kind not in SUPPORTED:
            kind_name = mjtGeom(kind).name.removeprefix("mjGEOM_").lower()
            raise UserError(
                f"Geom {model.geom(g).name or g!r} is of type {kind_name}, which "
                "the ray caster cannot draw. Allowed are plane, sphere, capsule, ellipsoid, "
                "cylinder, box and mesh: draw it with renderer='opengl', or put it in a "
                "geom group that is not drawn."
            )
    drawn = _without_twins(model, drawn)
    is_fixed = _is_fixed(model, model.geom_bodyid[drawn])
    emission = np.append(model.mat_emission, 0)  # the last is for no material, -1
    return Scenery(
        kind=model.geom_type.astype(int32),
        size=model.geom_size.astype(float32),
        emission=emission[model.geom_matid].astype(float32),
        meshes=_read_meshes(model, drawn, triangle_m),
        rgba=geom_colours(model),
        fixed=drawn[is_fixed].astype(int32),
        moving=drawn[~is_fixed].astype(int32),
    )


def read_view(
    model: MjModel, data: MjData, camera: int | str
) -> tuple[Floats32, float]:
    """Read a perspective camera that stands still, by name or id.

    Return position [m] and row-major rotation from camera to world, (12,), and tan(fovy / 2).
    """
    names = [model.camera(i).name for i in range(model.ncam)]
    if isinstance(camera, str):
        if camera not in names:
            raise unknown_name("camera", camera, names)
        camera = names.index(camera)
    if not 0 <= camera < len(names):
        raise UserError(
            f"Camera {camera} does not exist; the model has {len(names)}, from 0."
        )
    label = names[camera] or camera
    if not _is_fixed(model, model.cam_bodyid[camera]) or model.cam_mode[camera] != 0:
        raise UserError(
            f"Camera {label!r} moves with a body; the ray caster needs a camera that stands still: "
            "attach it to the world with mode 'fixed'."
        )
    # 0 is perspective; before MuJoCo 3.4 the field says whether it is orthographic.
    projection = "cam_projection"
    if not hasattr(model, projection):
        projection = "cam_orthographic"
    if getattr(model, projection)[camera] or model.cam_sensorsize[camera].any():
        raise UserError(
            f"Camera {label!r} is orthographic or has a sensor size; the ray caster needs a "
            "perspective camera given by fovy."
        )
    view = np.append(data.cam_xpos[camera], data.cam_xmat[camera])
    return view.astype(float32), math.tan(math.radians(model.cam_fovy[camera]) / 2)


def read_lamps(model: MjModel, data: MjData) -> Floats32:
    """Read a model's lights, (4, 3) in world coordinates.

    Rows: sum of ambient colours, diffuse colours of headlight and directional light, and the unit
    vector towards the latter.
    """
    lamps = np.zeros((4, 3), float32)
    head = model.vis.headlight
    if head.active:
        lamps[0] += head.ambient
        lamps[1] = head.diffuse
    active = np.flatnonzero(model.light_active)
    directional = mjtLightType.mjLIGHT_DIRECTIONAL
    if len(active) > 1 or (model.light_type[active] != directional).any():
        raise UserError(
            "The ray caster supports a headlight and at most one directional light; the model has "
            f"{len(active)} lights. Make the main one directional and switch the others off."
        )
    for i in active:
        lamps[0] += model.light_ambient[i]
        lamps[2] = model.light_diffuse[i]
        lamps[3] = -data.light_xdir[i]
    return lamps


def _without_twins(model: MjModel, drawn: Integers) -> Integers:
    """Leave out geoms that show the same mesh at the same place in the same colour as another.

    Converted models often show each mesh once to be seen and once to collide.
    """
    is_mesh = model.geom_type[drawn] == MESH
    rows = np.column_stack(
        [
            np.where(is_mesh, -1, drawn),  # other geoms have no twins
            model.geom_bodyid[drawn],
            model.geom_dataid[drawn],
            model.geom_matid[drawn],
            model.geom_pos[drawn],
            model.geom_quat[drawn],
            model.geom_rgba[drawn],
        ]
    )
    _, first = np.unique(rows, axis=0, return_index=True)
    return drawn[np.sort(first)]


def _is_fixed(model: MjModel, body: Integers | int) -> Mask:
    """Tell whether bodies are permanently welded to the world (a mocap body is not)."""
    is_welded: Mask = model.body_weldid[body] == 0
    return is_welded & (model.body_mocapid[model.body_rootid[body]] < 0)


def _read_meshes(model: MjModel, drawn: Integers, triangle_m: Floats | None) -> Meshes:
    """Read the triangles of the drawn mesh geoms, those of a shared mesh once."""
    span = np.zeros((model.ngeom, 4), int32)
    winding = np.zeros(model.ngeom, int32)
    geoms = drawn[model.geom_type[drawn] == MESH]
    mesh_ids = model.geom_dataid[geoms]
    meshes = [NO_MESH]
    vertex_stop = 0
    face_stop = 0
    for mesh in np.unique(mesh_ids):
        users = geoms[mesh_ids == mesh]
        shape = _read_mesh(model, mesh)
        if triangle_m is not None:
            shape = simplified(shape, float(triangle_m[users].min()))
        vertex_start = vertex_stop
        face_start = face_stop
        vertex_stop += len(shape.vertex)
        face_stop += len(shape.face)
        span[users] = (vertex_start, vertex_stop, face_start, face_stop)
        winding[users] = _winding(shape)
        meshes.append(shape._replace(face=shape.face + int32(vertex_start)))
    vertex, face, normal = map(np.concatenate, zip(*meshes, strict=True))
    return Meshes(
        vertex=vertex,
        face=face,
        normal=normal.reshape(-1, 9),
        span=span,
        winding=winding,
        middle=model.geom_aabb[:, :3].astype(float32),
        half=model.geom_aabb[:, 3:].astype(float32),
    )


def _read_mesh(model: MjModel, mesh: int) -> Mesh:
    """Read one mesh, with normals that fit its triangles."""
    first = model.mesh_vertadr[mesh]
    vertices = slice(first, first + model.mesh_vertnum[mesh])
    vertex = model.mesh_vert[vertices].astype(float32)
    first = model.mesh_faceadr[mesh]
    triangles = slice(first, first + model.mesh_facenum[mesh])
    face = model.mesh_face[triangles].astype(int32)
    corner = model.mesh_facenormal[triangles] + model.mesh_normaladr[mesh]
    normals = _plausible_normals(model.mesh_normal[corner], vertex[face])
    return Mesh(vertex, face, normals)


def _winding(mesh: Mesh) -> int:
    """Return the orientation of a closed mesh's triangles (see ``Meshes``), 0 for an open mesh."""
    # Corners at one place are one corner, even if they are vertices with different normals.
    _, start = merge_vertices(mesh.vertex, mesh.face)
    end = np.roll(start, -1, axis=1)
    count = len(mesh.vertex)
    forward = start * count + end
    backward = end * count + start
    if not np.array_equal(np.unique(forward), np.sort(backward, axis=None)):
        return 0
    corners = mesh.vertex.astype(np.float64)[mesh.face]
    volumes = corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])
    return int(np.sign(np.sum(volumes)))


def _plausible_normals(normals: Floats32, corners: Floats32) -> Floats32:
    """Replace corner normals (T, 3, 3) that deviate from their triangle's by the triangle's own.

    MuJoCo gives meshes without faces the triangles of their hull, and normals that do not fit.
    """
    face_normal = unit_normals(corners)[:, None]
    deviates = (normals * face_normal).sum(axis=2) < MIN_NORMAL_COSINE
    return np.where(deviates[:, :, None], face_normal, normals).astype(float32)
