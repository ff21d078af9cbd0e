"""Scenery: what a MuJoCo model looks like, as float32 arrays for the ray caster's kernels."""

import math
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from knowarm.errors import UserError, unknown_name
from knowarm.world.render.intersections import MESH, SUPPORTED
from knowarm.world.render.mesh_simplification import Mesh, simplified, unit_normals
from knowarm.world.scene.appearance import geom_colours

MIN_NORMAL_COSINE = 0.25
"""Below this cosine between a corner's and its triangle's normal the corner's is replaced."""


class Meshes(NamedTuple):
    """All meshes of a model, concatenated. V vertices, T triangles, G geoms."""

    vertex: NDArray[np.float32]  # Vertices in the frame of their geom [m], (V, 3)
    face: NDArray[np.int32]  # Vertices of each triangle, (T, 3)
    normal: NDArray[np.float32]  # Unit normals at each triangle's corners, (T, 9)
    # First and one past the last vertex, first and one past the last triangle of each geom, zero
    # for geoms that are not meshes, (G, 4)
    span: NDArray[np.int32]
    # 1 for a geom whose mesh is closed with triangles anticlockwise from outside, -1 if clockwise,
    # 0 if open or not a mesh, (G,)
    winding: NDArray[np.int32]
    middle: NDArray[np.float32]  # Centre of each geom's bounding box in its frame [m], (G, 3)
    half: NDArray[np.float32]  # Half-sizes of that box [m], (G, 3)


class Scenery(NamedTuple):
    """The geoms of a model. G geoms, F fixed and M moving ones that are drawn."""

    kind: NDArray[np.int32]  # Type of each geom, (G,)
    size: NDArray[np.float32]  # ``geom_size`` [m], (G, 3)
    emission: NDArray[np.float32]  # Emission of each geom's material, (G,)
    meshes: Meshes  # The triangles of mesh geoms
    # Colour of each geom, its material's where it has none of its own, (G, 4)
    rgba: NDArray[np.float32]
    fixed: NDArray[np.int32]  # Ids of the drawn geoms that stand still in every state, (F,)
    moving: NDArray[np.int32]  # Ids of the drawn geoms that can move, (M,)


def read_scenery(
    model: mujoco.MjModel,
    geom_groups: tuple[int, ...],
    triangle_m: NDArray[np.float64] | None = None,
) -> Scenery:
    """Read the geoms of a model in some groups.

    ``triangle_m`` is the size to which the triangles of each mesh geom are enlarged [m], (G,).
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
    drawn = _without_twins(model, drawn)
    fixed = np.array([_is_fixed(model, b) for b in model.geom_bodyid], dtype=np.bool_)
    emission = np.zeros(model.ngeom, dtype=np.float32)
    has_material = model.geom_matid >= 0
    emission[has_material] = model.mat_emission[model.geom_matid[has_material]]
    return Scenery(
        kind=model.geom_type.astype(np.int32),
        size=model.geom_size.astype(np.float32),
        emission=emission,
        meshes=_read_meshes(model, drawn, triangle_m),
        rgba=geom_colours(model),
        fixed=drawn[fixed[drawn]].astype(np.int32),
        moving=drawn[~fixed[drawn]].astype(np.int32),
    )


def read_view(
    model: mujoco.MjModel, data: mujoco.MjData, camera: int | str
) -> tuple[NDArray[np.float32], float]:
    """Read a perspective camera that stands still, by name or id.

    Return position [m] and row-major rotation from camera to world, (12,), and tan(fovy / 2).
    """
    names = [model.camera(i).name for i in range(model.ncam)]
    if isinstance(camera, str):
        if camera not in names:
            raise unknown_name("camera", camera, names)
        camera = names.index(camera)
    if not 0 <= camera < model.ncam:
        raise UserError(f"Camera {camera} does not exist; the model has {model.ncam}, from 0.")
    label = names[camera] or camera
    if not _is_fixed(model, model.cam_bodyid[camera]) or model.cam_mode[camera] != 0:
        raise UserError(
            f"Camera {label!r} moves with a body; the ray caster needs a camera that stands still: "
            "attach it to the world with mode 'fixed'."
        )
    if model.cam_projection[camera] != mujoco.mjtProjection.mjPROJ_PERSPECTIVE or np.any(
        model.cam_sensorsize[camera]
    ):
        raise UserError(
            f"Camera {label!r} is orthographic or has a sensor size; the ray caster needs a "
            "perspective camera given by fovy."
        )
    view = np.concatenate([data.cam_xpos[camera], data.cam_xmat[camera].reshape(9)])
    return view.astype(np.float32), math.tan(math.radians(model.cam_fovy[camera]) / 2)


def read_lamps(model: mujoco.MjModel, data: mujoco.MjData) -> NDArray[np.float32]:
    """Read a model's lights, (4, 3) in world coordinates.

    Rows: sum of ambient colours, diffuse colours of headlight and directional light, and the unit
    vector towards the latter.
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


def _without_twins(model: mujoco.MjModel, drawn: NDArray[np.int64]) -> NDArray[np.int64]:
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


def _is_fixed(model: mujoco.MjModel, body: int) -> bool:
    """Tell whether a body is permanently welded to the world (a mocap body is not)."""
    return bool(model.body_weldid[body] == 0 and model.body_mocapid[model.body_rootid[body]] < 0)


def _read_meshes(
    model: mujoco.MjModel, drawn: NDArray[np.intp], triangle_m: NDArray[np.float64] | None
) -> Meshes:
    """Read the triangles of the drawn mesh geoms, those of a shared mesh once."""
    span = np.zeros((model.ngeom, 4), dtype=np.int32)
    winding = np.zeros(model.ngeom, dtype=np.int32)
    geoms = drawn[model.geom_type[drawn] == MESH]
    meshes: list[Mesh] = []
    vertices, triangles = 0, 0
    for mesh in np.unique(model.geom_dataid[geoms]):
        users = geoms[model.geom_dataid[geoms] == mesh]
        shape = _read_mesh(model, mesh)
        if triangle_m is not None:
            shape = simplified(shape, float(triangle_m[users].min()))
        meshes.append(shape._replace(face=shape.face + np.int32(vertices)))
        after = vertices + len(shape.vertex), triangles + len(shape.face)
        span[users] = vertices, after[0], triangles, after[1]
        winding[users] = _winding(shape)
        vertices, triangles = after
    empty = Mesh(
        np.empty((0, 3), np.float32), np.empty((0, 3), np.int32), np.empty((0, 3, 3), np.float32)
    )
    vertex, face, normal = (np.concatenate(arrays) for arrays in zip(empty, *meshes, strict=True))
    return Meshes(
        vertex=vertex,
        face=face,
        normal=normal.reshape(-1, 9),
        span=span,
        winding=winding,
        middle=model.geom_aabb[:, :3].astype(np.float32),
        half=model.geom_aabb[:, 3:].astype(np.float32),
    )


def _read_mesh(model: mujoco.MjModel, mesh: int) -> Mesh:
    """Read one mesh, with normals that fit its triangles."""
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    vertex = model.mesh_vert[first : first + count].astype(np.float32)
    first, count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    face = model.mesh_face[first : first + count].astype(np.int32)
    corner = model.mesh_facenormal[first : first + count] + model.mesh_normaladr[mesh]
    return Mesh(vertex, face, _plausible_normals(model.mesh_normal[corner], vertex[face]))


def _winding(mesh: Mesh) -> int:
    """Return the orientation of a closed mesh's triangles (see ``Meshes``), 0 for an open mesh."""
    vertices, faces = mesh.vertex.astype(np.float64), mesh.face.astype(np.int64)
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
    own = unit_normals(corners)
    deviates = (normals * own[:, None]).sum(axis=2) < MIN_NORMAL_COSINE
    return np.where(deviates[:, :, None], own[:, None], normals).astype(np.float32)
