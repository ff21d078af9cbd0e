"""Composition of a scene: one ``MjSpec`` of robot, servos, targets, support, lights and camera."""

from collections.abc import Sequence
from itertools import count
from typing import Any

import mujoco
import numpy as np

from knowarm.arrays import Floats
from knowarm.errors import UserError
from knowarm.questions import object_of
from knowarm.world.objects.target import Target
from knowarm.world.robots.robot import Robot, Table
from knowarm.world.scene.mjcf import (
    check_names,
    hide_sites,
    hold,
    read_mjcf,
    strip,
    surroundings,
    take_ranges,
)

ROBOT_PREFIX = "robot/"  # Prefix of all names of the robot's own file in the scene
ROBOT_BIT, SUPPORT_BIT = 1, 2
"""MuJoCo contact bits: the only contacts are those between robot and support."""


def attach_robot(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Attach the robot, gravity compensated, with only the joints that the agent moves.

    Floor, tables and loose bodies of its file are left out: targets and support are the scene's.
    """
    owner = f"Robot {robot.name!r}"
    part = read_mjcf(robot.mjcf, owner)
    for field in ("joints", "held_joints"):
        check_names(owner, field, getattr(robot, field), robot.mjcf, "joints", part.joints)
    if robot.tcp_body is not None:
        check_names(owner, "tcp_body", [robot.tcp_body], robot.mjcf, "bodies", part.bodies)
        body = part.body(robot.tcp_body)
        body.add_site(name=robot.tcp_site, pos=robot.tcp_position_m, quat=robot.tcp_quaternion)
    else:
        remedy = " Name one of them, or set tcp_body to have the site added."
        check_names(owner, "tcp_site", [robot.tcp_site], robot.mjcf, "sites", part.sites, remedy)
    take_ranges(part, robot.joints)
    strip(part, spec)
    for element in surroundings(part, (*robot.joints, *robot.held_joints)):
        part.delete(element)
    for joint in list(part.joints):
        if joint.name not in robot.joints:
            if joint.name in robot.held_joints:
                hold(part, joint, robot.held_joints[joint.name], owner)
            part.delete(joint)
    for joint in part.joints:
        joint.actfrclimited = False  # a limit of its own motor; servos demand more
    for body in part.bodies:
        body.gravcomp = 1
    for geom in part.geoms:
        collides = geom.contype != 0 or geom.conaffinity != 0
        geom.contype = ROBOT_BIT if collides else 0
        geom.conaffinity = SUPPORT_BIT if collides else 0
    hide_sites(part)
    half = np.radians(robot.base_yaw_deg) / 2
    turn = [np.cos(half), 0, 0, np.sin(half)]
    frame = spec.worldbody.add_frame(pos=robot.base_position_m, quat=turn)
    spec.attach(part, frame=frame, prefix=ROBOT_PREFIX)


def attach_target(
    spec: mujoco.MjSpec, robot: Robot, target: Target, beside: Sequence[Target] = ()
) -> None:
    """Attach a target as a mocap body without physics, at its yaw.

    Of several parts of one object among the targets ``beside``, each draws its own geoms.
    """
    owner = f"Target {target.name!r}"
    part = read_mjcf(target.mjcf, owner, target.xml)
    bodies = part.worldbody.bodies
    if len(bodies) != 1 or list(part.worldbody.geoms):
        raise UserError(
            f"{owner}: {target.mjcf.name} must hold one top-level body with all geoms in it; it "
            f"holds {len(bodies)}."
        )
    check_names(owner, "grasp_site", [target.grasp_site], target.mjcf, "sites", part.sites)
    check_names(owner, "coloured_geoms", target.coloured_geoms, target.mjcf, "geoms", part.geoms)
    strip(part, spec)
    for joint in list(part.joints):
        part.delete(joint)
    free = (name for i in count() if part.geom(name := f"geom_{i}") is None)
    for geom in part.geoms:
        geom.contype = geom.conaffinity = 0
        geom.name = geom.name or next(free)
    whole = object_of(target.name)
    parts = [each for each in beside if object_of(each.name) == whole] or [target]
    for geom in list(part.geoms):
        if target != next((each for each in parts if geom.name in each.part_geoms), parts[0]):
            part.delete(geom)
    hide_sites(part)
    yaw = np.radians(robot.yaw_deg(target.name))
    body = bodies[0]
    body.name = body.name or "body"
    body.mocap = True
    x, y = robot.rectangle_centre_m
    body.pos = [x, y, robot.support_height_m]
    body.quat = [np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]
    frame = spec.worldbody.add_frame()
    spec.attach(part, frame=frame, prefix=f"{target.name}/")


CONTROL_PERIOD_S = 0.1
"""Time between actions [s]. The largest MPI of a shipped robot, .10 rad, is then 1 rad/s, which is
below the limit of all joints."""

STOP_RAD, SLOWER = 0.01, 0.3
"""Wanted largest distance from its target at which friction stops a joint, and share by which
damping slows it."""

SUBSTEPS = 5  # Physics steps per control period
CAMERA = "policy"  # Name of the camera that shows the observations
DISTRACTOR = "distractor_"  # Prefix of the names of distractors
FLOOR_RGBA = (0.60, 0.61, 0.63, 1.0)
TABLE_RGBA = (0.52, 0.54, 0.57, 1.0)
LEG_RGBA = (0.35, 0.36, 0.38, 1.0)


def compose(robot: Robot, targets: Sequence[Target], distractors: int = 0) -> mujoco.MjSpec:
    """Compose floor, table, lights, camera, robot with servos, and targets as mocap bodies.

    All robot bodies are gravity compensated. The only contacts are between robot and support.
    """
    spec = mujoco.MjSpec()
    spec.modelname = f"knowarm {robot.name}"
    spec.compiler.degree = False
    spec.option.timestep = CONTROL_PERIOD_S / SUBSTEPS
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    _add_surroundings(spec, robot)
    attach_robot(spec, robot)
    for target in targets:
        attach_target(spec, robot, target, targets)
    _add_distractors(spec, robot, distractors)
    _add_servos(spec, robot)
    return spec


def _add_servos(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Add a critically damped position servo per joint, tuned to the inertia it moves.

    With m the diagonal of the joint-space inertia at home and w the natural frequency [rad/s], the
    gains are kp = m w^2 and kv = 2 m w. Where the file's friction f or damping d is large for the
    inertia, m is raised until f stops a joint at most `STOP_RAD` from its target, and d slows it by
    at most `SLOWER`.
    """
    model = spec.compile()
    data = mujoco.MjData(model)
    ids = []
    for name, angle in zip(robot.joints, robot.home, strict=True):
        joint = model.joint(ROBOT_PREFIX + name)
        _check_joint(robot, name, joint)
        data.qpos[model.jnt_qposadr[joint.id]] = angle
        ids.append(model.jnt_dofadr[joint.id])
    mujoco.mj_forward(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    frequency = 2 * np.pi * robot.servo_frequency_hz
    for name, dof in zip(robot.joints, ids, strict=True):
        mass = max(
            float(inertia[dof, dof]),
            float(model.dof_frictionloss[dof]) / (STOP_RAD * frequency**2),
            float(model.dof_damping[dof]) / (2 * SLOWER * frequency),
        )
        actuator = spec.add_actuator(
            name=name, target=ROBOT_PREFIX + name, trntype=mujoco.mjtTrn.mjTRN_JOINT
        )
        actuator.set_to_position(kp=mass * frequency**2, kv=2 * mass * frequency)


def _check_joint(robot: Robot, name: str, joint: Any) -> None:
    """Check that a joint has one degree of freedom, and a range if it is a slide."""
    kind, limited = int(joint.type[0]), bool(joint.limited[0])
    hinge, slide = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
    if kind not in (hinge, slide) or (kind == slide and not limited):
        raise UserError(
            f"Robot {robot.name!r}: joint {name!r} must be a hinge, or a slide with a range "
            "(actions are clipped to it): give it a range in the MJCF or remove it from joints."
        )


def _add_surroundings(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Add floor, table, lights and camera."""
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
    # Light from the camera and from above: edges are visible, and no side of an object is black.
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
    if np.linalg.norm(backward[:2]) < 1e-6:
        raise UserError(
            f"Robot {robot.name!r}: camera_position_m {robot.camera_position_m} must not lie "
            f"straight above or below camera_look_at_m {robot.camera_look_at_m}; shift one of them."
        )
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, level_axes(backward).ravel())
    world.add_camera(name=CAMERA, pos=position, quat=quaternion, fovy=robot.camera_fovy_deg)


def level_axes(backward: Floats) -> Floats:
    """Return right, up and backward of a level camera as columns, (3, 3)."""
    right = np.cross([0.0, 0.0, 1.0], backward)
    axes = np.stack([right, np.cross(backward, right), backward], axis=1)
    return np.asarray(axes / np.linalg.norm(axes, axis=0))


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


def _add_distractors(spec: mujoco.MjSpec, robot: Robot, count: int) -> None:
    """Add objects without physics that are never the target, each of a different shape."""
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
