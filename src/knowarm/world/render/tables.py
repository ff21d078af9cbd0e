"""A MuJoCo model goes in; the float32 arrays that the drawing loops read come out."""

import math
from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray

from knowarm.errors import UserError, unknown_name

PLANE, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH = 0, 2, 3, 4, 5, 6, 7
"""MuJoCo's geom types, as plain numbers for compiled code."""

DEFAULT_RGBA = (0.5, 0.5, 0.5, 1.0)
"""A geom with this colour takes its material's."""


@dataclass(frozen=True, kw_only=True)
class Tables:
    """What a model looks like. G geoms; world frame unless said otherwise."""

    kind: NDArray[np.int32] = field(repr=False)
    """Type of each geom, (G,)."""

    size: NDArray[np.float32] = field(repr=False)
    """``geom_size`` [m], (G, 3)."""

    glow: NDArray[np.float32] = field(repr=False)
    """Emission of each geom's material, (G,)."""

    rgba: NDArray[np.float32] = field(repr=False)
    """Colour of each geom, its material's where it has none of its own, (G, 4)."""

    position: NDArray[np.float32] = field(repr=False)
    """Positions at the model's start pose [m], (G, 3)."""

    matrix: NDArray[np.float32] = field(repr=False)
    """Row-major rotations from geom to world at the start pose, (G, 9)."""

    fixed: NDArray[np.int32] = field(repr=False)
    """Drawn geoms that stand still in every state, (S,)."""

    moving: NDArray[np.int32] = field(repr=False)
    """Drawn geoms that can move, (M,)."""

    camera: NDArray[np.float32] = field(repr=False)
    """Position [m] and row-major rotation from camera to world, (12,)."""

    half_height: float
    """Half the image's height at depth 1: tan(fovy / 2)."""

    lamps: NDArray[np.float32] = field(repr=False)
    """Sum of ambient colours; headlight and sun diffuse colours; towards the sun, (4, 3)."""


def read_tables(model: mujoco.MjModel, camera: int | str, geom_groups: tuple[int, ...]) -> Tables:
    """Read what is to be drawn from a model.

    Raises:
        UserError: the camera is unknown, orthographic or on a moving body; a drawn geom is of a
            type that cannot be drawn; there is more light than a headlight and a directional one.
    """
    camera_id = find_camera(model, camera)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_camlight(model, data)

    drawn = np.flatnonzero(np.isin(model.geom_group, geom_groups))
    for g in drawn:
        if model.geom_type[g] not in (PLANE, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH):
            raise UserError(
                f"Geom {model.geom(g).name or g!r} is of type "
                f"{mujoco.mjtGeom(model.geom_type[g]).name.removeprefix('mjGEOM_').lower()}, which "
                "the ray caster does not draw. Allowed are plane, sphere, capsule, ellipsoid, "
                "cylinder, box and mesh: draw it with renderer='opengl', or put it in a "
                "geom group that is not drawn."
            )
    standing = np.array([is_fixed(model, b) for b in model.geom_bodyid], dtype=np.bool_)
    matrix = data.cam_xmat[camera_id].reshape(9)
    return Tables(
        kind=model.geom_type.astype(np.int32),
        size=model.geom_size.astype(np.float32),
        glow=_emission(model),
        rgba=geom_colours(model),
        position=data.geom_xpos.astype(np.float32),
        matrix=data.geom_xmat.astype(np.float32),
        fixed=drawn[standing[drawn]].astype(np.int32),
        moving=drawn[~standing[drawn]].astype(np.int32),
        camera=np.concatenate([data.cam_xpos[camera_id], matrix]).astype(np.float32),
        half_height=math.tan(math.radians(model.cam_fovy[camera_id]) / 2),
        lamps=_lamps(model, data),
    )


def find_camera(model: mujoco.MjModel, camera: int | str) -> int:
    """Return the id of a perspective camera that stands still.

    Raises:
        UserError: there is none of this name or id, or it is another kind of camera.
    """
    names = [model.camera(i).name for i in range(model.ncam)]
    if isinstance(camera, str):
        if camera not in names:
            raise unknown_name("camera", camera, names)
        camera = names.index(camera)
    if not 0 <= camera < model.ncam:
        raise UserError(f"Camera {camera} does not exist; the model has {model.ncam}, from 0.")
    shown = names[camera] or camera
    if not is_fixed(model, model.cam_bodyid[camera]) or model.cam_mode[camera] != 0:
        raise UserError(
            f"Camera {shown!r} moves with a body; the ray caster takes cameras that stand still: "
            "attach it to the world with mode 'fixed'."
        )
    if model.cam_projection[camera] != mujoco.mjtProjection.mjPROJ_PERSPECTIVE or np.any(
        model.cam_sensorsize[camera]
    ):
        raise UserError(
            f"Camera {shown!r} is orthographic or has a sensor size; the ray caster takes "
            "perspective cameras given by fovy."
        )
    return camera


def is_fixed(model: mujoco.MjModel, body: int) -> bool:
    """Whether a body is welded to the world for good (a mocap body is not)."""
    return bool(model.body_weldid[body] == 0 and model.body_mocapid[model.body_rootid[body]] < 0)


def geom_colours(model: mujoco.MjModel) -> NDArray[np.float32]:
    """Colours as MuJoCo draws them, (G, 4): the geom's own, or its material's."""
    colours = model.geom_rgba.astype(np.float32)
    material = model.geom_matid
    takes = (material >= 0) & (model.geom_rgba == np.array(DEFAULT_RGBA, dtype=np.float32)).all(
        axis=1
    )
    colours[takes] = model.mat_rgba[material[takes]]
    return colours


def _emission(model: mujoco.MjModel) -> NDArray[np.float32]:
    glow = np.zeros(model.ngeom, dtype=np.float32)
    has = model.geom_matid >= 0
    glow[has] = model.mat_emission[model.geom_matid[has]]
    return glow


def _lamps(model: mujoco.MjModel, data: mujoco.MjData) -> NDArray[np.float32]:
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
            "The ray caster takes a headlight and at most one directional light; the model has "
            f"{len(active)} lights. Make the main one directional and switch the others off."
        )
    for i in active:
        lamps[0] += model.light_ambient[i]
        lamps[2] = model.light_diffuse[i]
        lamps[3] = -data.light_xdir[i]
    return lamps
