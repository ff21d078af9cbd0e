"""A robot's layout goes in; floor, table, lights and camera come out in the ``MjSpec``."""

import mujoco
import numpy as np

from knowarm.errors import UserError
from knowarm.world.robot import Robot, Table

CAMERA = "policy"
"""Name of the camera that draws the observations."""

DISTRACTOR = "distractor_"
"""What the names of distractors begin with."""

FLOOR_RGBA = (0.60, 0.61, 0.63, 1.0)
TABLE_RGBA = (0.52, 0.54, 0.57, 1.0)
LEG_RGBA = (0.35, 0.36, 0.38, 1.0)

ROBOT_BIT, SUPPORT_BIT = 1, 2
"""MuJoCo contact bits: the robot meets the support, and nothing else meets anything."""


def add_surroundings(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Write what stands around the robot, and the camera that looks at it.

    Raises:
        UserError: the camera looks straight down, which leaves its roll open.
    """
    world = spec.worldbody
    world.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[10, 10, 0.1],
        rgba=FLOOR_RGBA,
        contype=SUPPORT_BIT,
        conaffinity=ROBOT_BIT,
    )
    if robot.table:
        _add_table(world, robot.table)
    # Half from the camera, half from above: edges show, and no side of an object goes black.
    spec.visual.headlight.ambient = [0.35, 0.35, 0.35]
    spec.visual.headlight.diffuse = [0.35, 0.35, 0.35]
    spec.visual.headlight.specular = [0, 0, 0]
    world.add_light(
        name="sun",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=[0, 0, 3],
        dir=[-0.3, 0.35, -0.9],
        diffuse=[0.45, 0.45, 0.45],
        ambient=[0, 0, 0],
        specular=[0, 0, 0],
        castshadow=False,
    )
    position, look_at = np.array(robot.camera_position_m), np.array(robot.camera_look_at_m)
    backward = position - look_at
    right = np.cross([0.0, 0.0, 1.0], backward)
    if np.linalg.norm(right) < 1e-6:
        raise UserError(
            f"Robot {robot.name!r}: camera_position_m {robot.camera_position_m} must not lie "
            f"straight above or below camera_look_at_m {robot.camera_look_at_m}; shift one of them."
        )
    up = np.cross(backward, right)
    axes = np.stack([right, up, backward], axis=1)
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, (axes / np.linalg.norm(axes, axis=0)).ravel())
    world.add_camera(name=CAMERA, pos=position, quat=quaternion, fovy=robot.camera_fovy_deg)


def _add_table(world: mujoco.MjsBody, table: Table) -> None:
    half_x, half_y = table.half_size_m
    x, y = table.centre_m
    thickness = 0.03
    box = mujoco.mjtGeom.mjGEOM_BOX
    world.add_geom(
        name="table",
        type=box,
        size=[half_x, half_y, thickness / 2],
        pos=[x, y, table.height_m - thickness / 2],
        rgba=TABLE_RGBA,
        contype=SUPPORT_BIT,
        conaffinity=ROBOT_BIT,
    )
    leg = 0.02
    height = (table.height_m - thickness) / 2
    for i, (sx, sy) in enumerate([(-1, -1), (-1, 1), (1, -1), (1, 1)]):
        world.add_geom(
            name=f"table_leg_{i}",
            type=box,
            size=[leg, leg, height],
            pos=[x + sx * (half_x - leg), y + sy * (half_y - leg), height],
            rgba=LEG_RGBA,
            contype=0,
            conaffinity=0,
        )


def add_distractors(spec: mujoco.MjSpec, robot: Robot, count: int) -> None:
    """Add objects without physics that nobody is sent to, each of another shape."""
    shapes = mujoco.mjtGeom
    kinds = [
        (shapes.mjGEOM_BOX, [0.035, 0.035, 0.05], 0.05),
        (shapes.mjGEOM_SPHERE, [0.045, 0, 0], 0.045),
        (shapes.mjGEOM_CYLINDER, [0.05, 0.03, 0], 0.03),
        (shapes.mjGEOM_CAPSULE, [0.025, 0.05, 0], 0.075),
    ]
    x, y = robot.rectangle_centre_m
    for i, (kind, size, height) in enumerate(kinds[:count]):
        body = spec.worldbody.add_body(
            name=f"{DISTRACTOR}{i}", pos=[x, y, robot.support_height_m], mocap=True
        )
        body.add_geom(
            name=f"{DISTRACTOR}{i}",
            type=kind,
            size=size,
            pos=[0, 0, height],
            contype=0,
            conaffinity=0,
        )
