"""A robot's or a target's MJCF file goes in; it comes out attached to the scene's ``MjSpec``."""

from pathlib import Path

import mujoco
import numpy as np

from knowarm.errors import UserError
from knowarm.world.robot import Robot
from knowarm.world.surroundings import ROBOT_BIT, SUPPORT_BIT
from knowarm.world.target import Target

ROBOT_PREFIX = "robot/"
"""What every name of the robot's own file begins with in the scene."""


def read_mjcf(path: Path, owner: str) -> mujoco.MjSpec:
    """Read an MJCF file.

    Args:
        path: the file.
        owner: whose file it is, for the message ("Robot 'irb120'").

    Raises:
        UserError: when the file is missing or MuJoCo cannot read or compile it.
    """
    if not path.is_file():
        raise UserError(f"{owner}: mjcf is {str(path)!r}, and there is no such file.")
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        spec.compile()
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise UserError(
            f"{owner}: mjcf {str(path)!r} does not compile: {reason}. Mend the file; `python -m "
            f"mujoco.viewer --mjcf={path}` shows the same error."
        ) from None
    return spec


def attach_robot(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Attach the robot, gravity compensated, with only the joints the agent moves.

    Raises:
        UserError: the file does not compile, or lacks a named joint, body or site.
    """
    owner = f"Robot {robot.name!r}"
    part = read_mjcf(robot.mjcf, owner)
    joints = {joint.name: joint for joint in part.joints}
    for name in robot.joints:
        if name not in joints:
            raise UserError(
                f"{owner}: joints names {name!r}, which {robot.mjcf.name} does not have. Its "
                f"joints: {', '.join(sorted(filter(None, joints))) or 'none'}."
            )
    for name in robot.held_joints:
        if name not in joints:
            raise UserError(
                f"{owner}: held_joints names {name!r}, which {robot.mjcf.name} does not have. Its "
                f"joints: {', '.join(sorted(filter(None, joints))) or 'none'}."
            )
    if robot.tcp_body is not None:
        body = part.body(robot.tcp_body)
        if body is None:
            names = ", ".join(sorted(body.name for body in part.bodies if body.name))
            raise UserError(
                f"{owner}: tcp_body is {robot.tcp_body!r}, which {robot.mjcf.name} does not have. "
                f"Its bodies: {names}."
            )
        body.add_site(name=robot.tcp_site, pos=robot.tcp_position_m, quat=robot.tcp_quaternion)
    elif part.site(robot.tcp_site) is None:
        names = ", ".join(sorted(site.name for site in part.sites if site.name)) or "none"
        raise UserError(
            f"{owner}: tcp_site is {robot.tcp_site!r}, which {robot.mjcf.name} does not have. Its "
            f"sites: {names}. Name one of them, or set tcp_body to have the site added."
        )
    # Only arm, servos and contacts with the support are simulated; what a file brings along for
    # its own demo (keyframes, tendons, sensors, cameras, lights) would refer to removed joints.
    for elements in (
        part.keys,
        part.actuators,
        part.sensors,
        part.equalities,
        part.tendons,
        part.pairs,
        part.excludes,
        part.lights,
        part.cameras,
    ):
        for element in list(elements):
            part.delete(element)
    for joint in list(part.joints):
        if joint.name not in robot.joints:
            _hold(joint, robot.held_joints.get(joint.name, 0.0), owner)
            part.delete(joint)
    for body in part.bodies:
        body.gravcomp = 1
    for geom in part.geoms:
        collides = geom.contype != 0 or geom.conaffinity != 0
        geom.contype = ROBOT_BIT if collides else 0
        geom.conaffinity = SUPPORT_BIT if collides else 0
    _hide_sites(part)
    frame = spec.worldbody.add_frame(pos=robot.base_position_m)
    spec.attach(part, frame=frame, prefix=ROBOT_PREFIX)


def _hold(joint: mujoco.MjsJoint, value: float, owner: str) -> None:
    """Move a joint's body to where the joint would carry it, so that the joint can go."""
    if value == 0:
        return
    body = joint.parent
    flat = np.zeros(9)
    mujoco.mju_quat2Mat(flat, body.quat)
    rotation = flat.reshape(3, 3)
    axis = np.asarray(joint.axis) / np.linalg.norm(joint.axis)
    if joint.type == mujoco.mjtJoint.mjJNT_SLIDE:
        body.pos = body.pos + rotation @ axis * value
    elif joint.type == mujoco.mjtJoint.mjJNT_HINGE:
        turn = np.zeros(4)
        mujoco.mju_axisAngle2Quat(turn, axis, value)
        turned = np.zeros(9)
        mujoco.mju_quat2Mat(turned, turn)
        arm = np.asarray(joint.pos)
        body.pos = body.pos + rotation @ (arm - turned.reshape(3, 3) @ arm)
        quaternion = np.zeros(4)
        mujoco.mju_mulQuat(quaternion, body.quat, turn)
        body.quat = quaternion
    else:
        raise UserError(f"{owner}: held_joints can hold hinges and slides, {joint.name!r} is none.")


def attach_target(spec: mujoco.MjSpec, robot: Robot, target: Target) -> None:
    """Attach a target as a mocap body without physics, at its yaw.

    Raises:
        UserError: the file does not compile, holds more than one body, or lacks a named part.
    """
    owner = f"Target {target.name!r}"
    part = read_mjcf(target.mjcf, owner)
    bodies = part.worldbody.bodies
    if len(bodies) != 1 or list(part.worldbody.geoms):
        raise UserError(
            f"{owner}: {target.mjcf.name} must hold one top-level body with all geoms in it, and "
            f"holds {len(bodies)}."
        )
    if part.site(target.grasp_site) is None:
        names = ", ".join(sorted(site.name for site in part.sites if site.name)) or "none"
        raise UserError(
            f"{owner}: grasp_site is {target.grasp_site!r}, which {target.mjcf.name} does not "
            f"have. Its sites: {names}."
        )
    geom_names = {geom.name for geom in part.geoms}
    for name in target.coloured_geoms:
        if name not in geom_names:
            raise UserError(
                f"{owner}: coloured_geoms names {name!r}, which {target.mjcf.name} does not have. "
                f"Its geoms: {', '.join(sorted(filter(None, geom_names))) or 'none'}."
            )
    for joint in list(part.joints):
        part.delete(joint)
    for i, geom in enumerate(part.geoms):
        geom.contype = geom.conaffinity = 0
        geom.name = geom.name or f"geom_{i}"
    _hide_sites(part)
    yaw = np.radians(robot.yaw_deg(target.name))
    body = bodies[0]
    body.mocap = True
    x, y = robot.rectangle_centre_m
    body.pos = [x, y, robot.support_height_m]
    body.quat = [np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]
    frame = spec.worldbody.add_frame()
    spec.attach(part, frame=frame, prefix=f"{target.name}/")


def _hide_sites(part: mujoco.MjSpec) -> None:
    """Keep gripper and grasp frames out of every image; viewers show group 5 when asked."""
    for site in part.sites:
        site.group = 5
