"""Composition of a scene: one ``MjSpec`` of robot, servos, targets, support, lights and camera."""

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from mujoco import (
    MjData,
    MjsBody,
    MjSpec,
    mj_forward,
    mj_mulM,
    mjtGeom,
    mjtJoint,
    mjtTrn,
    mju_mat2Quat,
)
from numpy.linalg import norm

from knowarm.arrays import Floats
from knowarm.errors import UserError
from knowarm.questions import object_of
from knowarm.world.objects.target import Target
from knowarm.world.robots.robot import Robot, Table
from knowarm.world.scene.mjcf import (
    FLOORS,
    check_names,
    hide_sites,
    hold,
    read_mjcf,
    set_range,
    strip,
    surroundings,
    take_ranges,
    turn_about_z,
)

ROBOT_PREFIX = "robot/"  # Prefix of all names of the robot's own file in the scene
# MuJoCo contact bits: the only contacts are those between robot and support.
ROBOT_BIT = 1
SUPPORT_BIT = 2


def attach_robot(spec: MjSpec, robot: Robot) -> None:
    """Attach the robot, gravity compensated, with only the joints that the agent moves.

    Floor, furniture and loose bodies of its file are left out: targets and support are the scene's.
    """
    owner = f"Robot {robot.name!r}"
    mjcf = robot.mjcf
    held = robot.held_joints
    site = robot.tcp_site
    part = read_mjcf(mjcf, owner)
    check_names(owner, "joints", robot.joints, mjcf, "joints", part.joints)
    check_names(owner, "held_joints", held, mjcf, "joints", part.joints)
    if robot.tcp_body is not None:
        check_names(owner, "tcp_body", [robot.tcp_body], mjcf, "bodies", part.bodies)
        body = part.body(robot.tcp_body)
        body.add_site(name=site, pos=robot.tcp_position_m, quat=robot.tcp_quaternion)
    else:
        remedy = " Name one of them, or set tcp_body to have the site added."
        check_names(owner, "tcp_site", [site], mjcf, "sites", part.sites, remedy)
    take_ranges(part, robot.joints)
    ranges = robot.joint_ranges
    check_names(owner, "joint_ranges", ranges, mjcf, "joints", part.joints)
    for name, (low, high) in ranges.items():
        set_range(part, part.joint(name), low, high)
    strip(part, spec)
    for element in surroundings(part, (*robot.joints, *held)):
        part.delete(element)
    for joint in list(part.joints):
        if joint.name in robot.joints:
            joint.actfrclimited = False  # a limit of its own motor; servos demand more
        else:
            if joint.name in held:
                hold(part, joint, held[joint.name], owner)
            part.delete(joint)
    for body in part.bodies:
        body.gravcomp = 1
    for geom in part.geoms:
        if geom.contype != 0 or geom.conaffinity != 0:
            geom.contype = ROBOT_BIT
            geom.conaffinity = SUPPORT_BIT
    hide_sites(part)
    turn = turn_about_z(robot.base_yaw_deg)
    frame = spec.worldbody.add_frame(pos=robot.base_position_m, quat=turn)
    spec.attach(part, frame=frame, prefix=ROBOT_PREFIX)


def attach_target(
    spec: MjSpec,
    robot: Robot,
    target: Target,
    targets: Sequence[Target],
) -> None:
    """Attach one of the targets as a mocap body without physics, at its yaw.

    Of several parts of one object among the targets, each draws its own geoms.
    """
    owner = f"Target {target.name!r}"
    mjcf = target.mjcf
    part = read_mjcf(mjcf, owner, target.xml)
    for geom in list(part.worldbody.geoms):
        if geom.type in FLOORS:
            part.delete(geom)
    bodies = part.worldbody.bodies
    outside = [geom.name or "unnamed" for geom in part.worldbody.geoms]
    if len(bodies) != 1 or outside:
        raise UserError(
            f"{owner}: {mjcf.name} must hold one top-level body with all geoms in it; it holds "
            f"{len(bodies)}, and outside of them the geoms {', '.join(outside) or 'none'}. Put all "
            "that is the object into one body."
        )
    site = target.grasp_site
    coloured = target.coloured_geoms
    remedy = " Add the site: z is the approach, y the opening of the fingers."
    check_names(owner, "grasp_site", [site], mjcf, "sites", part.sites, remedy)
    check_names(owner, "coloured_geoms", coloured, mjcf, "geoms", part.geoms)
    strip(part, spec)
    for joint in list(part.joints):
        part.delete(joint)
    number = 0
    for geom in part.geoms:
        geom.contype = 0
        geom.conaffinity = 0
        if not geom.name:
            while part.geom(f"geom_{number}") is not None:
                number += 1
            geom.name = f"geom_{number}"
    whole = object_of(target.name)
    siblings = [other for other in targets if object_of(other.name) == whole]
    for geom in list(part.geoms):
        owners = [sibling for sibling in siblings if geom.name in sibling.part_geoms]
        if target != (owners or siblings)[0]:
            part.delete(geom)
    hide_sites(part)
    x, y = robot.rectangle_centre_m
    body = bodies[0]
    body.name = body.name or "body"
    body.mocap = True
    body.pos = [x, y, robot.support_height_m]
    body.quat = turn_about_z(robot.yaw_deg(target.name))
    frame = spec.worldbody.add_frame()
    spec.attach(part, frame=frame, prefix=f"{target.name}/")


CONTROL_PERIOD_S = 0.1
"""Time between actions [s]. The largest MPI of a shipped robot, .10 rad, is then 1 rad/s, which is
below the limit of all joints."""

# Wanted largest distance from its target at which friction stops a joint
STOP_RAD = 0.01
SLOWER = 0.3  # Wanted largest share by which damping slows it

SUBSTEPS = 5  # Physics steps per control period
CAMERA = "policy"  # Name of the camera that shows the observations
DISTRACTOR = "distractor_"  # Prefix of the names of distractors

_SURROUNDINGS = f"""
<mujoco>
  <compiler angle="radian"/>
  <option integrator="implicitfast"/>
  <visual>
    <headlight ambient="0.35 0.35 0.35" diffuse="0.35 0.35 0.35" specular="0 0 0"/>
  </visual>
  <worldbody>
    <geom name="floor" type="plane" size="10 10 0.1" rgba="0.60 0.61 0.63 1"
      contype="{SUPPORT_BIT}" conaffinity="{ROBOT_BIT}"/>
    <light name="sun" type="directional" pos="0 0 3" dir="-0.3 0.35 -0.9"
      diffuse="0.45 0.45 0.45" ambient="0 0 0" specular="0 0 0" castshadow="false"/>
  </worldbody>
</mujoco>
"""
"""Floor and lights. Light comes from the camera and from above: edges are visible, and no
side of an object is black."""


def compose(
    robot: Robot,
    targets: Sequence[Target],
    distractors: int = 0,
) -> MjSpec:
    """Compose floor, table, lights, camera, robot with servos, and targets as mocap bodies.

    All robot bodies are gravity compensated. The only contacts are between robot and support.
    """
    spec = MjSpec.from_string(_SURROUNDINGS)
    if robot.table:
        _add_table(spec.worldbody, robot.table)
    spec.modelname = f"knowarm {robot.name}"
    spec.option.timestep = CONTROL_PERIOD_S / SUBSTEPS
    _add_camera(spec.worldbody, robot)
    attach_robot(spec, robot)
    for target in targets:
        attach_target(spec, robot, target, targets)
    _add_distractors(spec, robot, distractors)
    _add_servos(spec, robot)
    return spec


def _add_servos(spec: MjSpec, robot: Robot) -> None:
    """Add a critically damped position servo per joint, tuned to the inertia it moves.

    With m the diagonal of the joint-space inertia at home and w the natural frequency [rad/s], the
    gains are kp = m w^2 and kv = 2 m w. Where the file's friction f or damping d is large for the
    inertia, m is raised until f stops a joint at most `STOP_RAD` from its target, and d slows it by
    at most `SLOWER`.
    """
    model = spec.compile()
    data = MjData(model)
    joints = [model.joint(ROBOT_PREFIX + name) for name in robot.joints]
    for name, joint, angle in zip(robot.joints, joints, robot.home, strict=True):
        _check_joint(robot, name, joint)
        data.qpos[joint.qposadr] = angle
    mj_forward(model, data)
    column = np.zeros(model.nv)
    frequency = 2 * np.pi * robot.servo_frequency_hz
    for name, joint in zip(robot.joints, joints, strict=True):
        dof = joint.dofadr[0]
        least_for_friction = joint.frictionloss[0] / (STOP_RAD * frequency**2)
        least_for_damping = joint.damping[0] / (2 * SLOWER * frequency)
        mj_mulM(model, data, column, np.eye(model.nv)[dof])
        mass = float(max(column[dof], least_for_friction, least_for_damping))
        actuator = spec.add_actuator(
            name=name, target=joint.name, trntype=mjtTrn.mjTRN_JOINT
        )
        actuator.set_to_position(kp=mass * frequency**2, kv=2 * mass * frequency)


def _check_joint(robot: Robot, name: str, joint: Any) -> None:
    """Check that a joint has one degree of freedom, and a range if it is a slide."""
    kind = joint.type[0]
    is_limited_slide = kind == mjtJoint.mjJNT_SLIDE and joint.limited[0]
    if kind != mjtJoint.mjJNT_HINGE and not is_limited_slide:
        raise UserError(
            f"Robot {robot.name!r}: joint {name!r} must be a hinge, or a slide with a range "
            "(actions are clipped to it): give it a range in the MJCF or remove it from joints."
        )


def _add_camera(world: MjsBody, robot: Robot) -> None:
    """Add the policy's camera, level or rolled."""
    position = np.array(robot.camera_position_m)
    backward = position - np.array(robot.camera_look_at_m)
    if norm(backward[:2]) < 1e-6:
        raise UserError(
            f"Robot {robot.name!r}: camera_position_m {robot.camera_position_m} must not lie "
            f"straight above or below camera_look_at_m {robot.camera_look_at_m}; shift one of them."
        )
    quaternion = np.zeros(4)
    axes = roll(level_axes(backward), robot.camera_roll_deg)
    mju_mat2Quat(quaternion, axes.ravel())
    world.add_camera(
        name=CAMERA, pos=position, quat=quaternion, fovy=robot.camera_fovy_deg
    )


def level_axes(backward: Floats) -> Floats:
    """Return right, up and backward of a level camera as columns, (3, 3)."""
    right = np.cross([0.0, 0.0, 1.0], backward)
    axes = np.stack([right, np.cross(backward, right), backward], axis=1)
    return axes / norm(axes, axis=0)


def roll(axes: Floats, degrees: float) -> Floats:
    """Turn a camera's axes (3, 3) about the third, its right side down [deg]."""
    turn = np.radians(-degrees)
    right = np.cos(turn) * axes[:, 0] + np.sin(turn) * axes[:, 1]
    up = np.cos(turn) * axes[:, 1] - np.sin(turn) * axes[:, 0]
    return np.stack([right, up, axes[:, 2]], axis=1)


def _add_table(world: MjsBody, table: Table) -> None:
    """Add a table: its top, on which things stand, and four legs."""
    thickness = 0.015  # half of each
    width = 0.02
    height = (table.height_m - 2 * thickness) / 2
    size = np.array(table.half_size_m)
    world.add_geom(
        name="table",
        type=mjtGeom.mjGEOM_BOX,
        size=[*size, thickness],
        pos=[*table.centre_m, table.height_m - thickness],
        rgba=[0.52, 0.54, 0.57, 1],
        contype=SUPPORT_BIT,
        conaffinity=ROBOT_BIT,
    )
    for i, signs in enumerate(product((-1, 1), repeat=2)):
        corner = table.centre_m + np.array(signs) * (size - width)
        world.add_geom(
            name=f"table_leg_{i}",
            type=mjtGeom.mjGEOM_BOX,
            size=[width, width, height],
            pos=[*corner, height],
            rgba=[0.35, 0.36, 0.38, 1],
            contype=0,
            conaffinity=0,
        )


# Shape, size [m] and height of the centre [m] of each distractor
DISTRACTOR_SHAPES = (
    (mjtGeom.mjGEOM_BOX, [0.035, 0.035, 0.05], 0.05),
    (mjtGeom.mjGEOM_SPHERE, [0.045, 0, 0], 0.045),
    (mjtGeom.mjGEOM_CYLINDER, [0.05, 0.03, 0], 0.03),
    (mjtGeom.mjGEOM_CAPSULE, [0.025, 0.05, 0], 0.075),
)


def _add_distractors(spec: MjSpec, robot: Robot, count: int) -> None:
    """Add objects without physics that are never the target, each of a different shape."""
    x, y = robot.rectangle_centre_m
    for i, (kind, size, height) in enumerate(DISTRACTOR_SHAPES[:count]):
        name = f"{DISTRACTOR}{i}"
        body = spec.worldbody.add_body(
            name=name, pos=[x, y, robot.support_height_m], mocap=True
        )
        body.add_geom(
            name=name,
            type=kind,
            size=size,
            pos=[0, 0, height],
            contype=0,
            conaffinity=0,
        )
