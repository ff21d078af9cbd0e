"""Attachment of a robot's or target's MJCF file to the ``MjSpec`` of a scene."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from knowarm.errors import UserError
from knowarm.reading import one_line, reading
from knowarm.world.objects.target import Target
from knowarm.world.robots.robot import Robot

ROBOT_PREFIX = "robot/"  # Prefix of all names of the robot's own file in the scene
ROBOT_BIT, SUPPORT_BIT = 1, 2
"""MuJoCo contact bits: the only contacts are those between robot and support."""


def read_mjcf(path: Path, owner: str) -> mujoco.MjSpec:
    """Read an MJCF file; messages name the description of it, its owner ("Robot 'irb120'")."""
    with reading(path, "Give the path of an MJCF file."):
        is_file = path.is_file()
    if not is_file:
        raise UserError(f"{owner}: mjcf is {str(path)!r}, and there is no such file.")
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise UserError(
            f"{owner}: mjcf {str(path)!r} does not compile: {one_line(error)}. Correct the file; "
            f"`python -m mujoco.viewer --mjcf={path}` shows the same error."
        ) from None
    return spec


def attach_robot(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Attach the robot, gravity compensated, with only the joints that the agent moves."""
    owner = f"Robot {robot.name!r}"
    part = read_mjcf(robot.mjcf, owner)
    for field in ("joints", "held_joints"):
        _check_names(owner, field, getattr(robot, field), robot.mjcf, "joints", part.joints)
    if robot.tcp_body is not None:
        _check_names(owner, "tcp_body", [robot.tcp_body], robot.mjcf, "bodies", part.bodies)
        body = part.body(robot.tcp_body)
        body.add_site(name=robot.tcp_site, pos=robot.tcp_position_m, quat=robot.tcp_quaternion)
    else:
        remedy = " Name one of them, or set tcp_body to have the site added."
        _check_names(owner, "tcp_site", [robot.tcp_site], robot.mjcf, "sites", part.sites, remedy)
    # Only arm, servos and contacts with the support are simulated. What else a file contains for
    # its own demo (keyframes, tendons, sensors, cameras, lights) would refer to removed joints.
    kinds = "keys actuators sensors equalities tendons pairs excludes lights cameras"
    for kind in kinds.split():
        for element in list(getattr(part, kind)):
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
    """Move a joint's body to its pose at a joint value, so that the joint can be removed."""
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
        raise UserError(
            f"{owner}: held_joints can hold hinges and slides; {joint.name!r} is neither."
        )


def attach_target(spec: mujoco.MjSpec, robot: Robot, target: Target) -> None:
    """Attach a target as a mocap body without physics, at its yaw."""
    owner = f"Target {target.name!r}"
    part = read_mjcf(target.mjcf, owner)
    bodies = part.worldbody.bodies
    if len(bodies) != 1 or list(part.worldbody.geoms):
        raise UserError(
            f"{owner}: {target.mjcf.name} must hold one top-level body with all geoms in it; it "
            f"holds {len(bodies)}."
        )
    _check_names(owner, "grasp_site", [target.grasp_site], target.mjcf, "sites", part.sites)
    _check_names(owner, "coloured_geoms", target.coloured_geoms, target.mjcf, "geoms", part.geoms)
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
    """Move the sites to group 5, which no image shows and viewers show on request."""
    for site in part.sites:
        site.group = 5


def _check_names(
    owner: str,
    field: str,
    names: Iterable[str],
    mjcf: Path,
    kind: str,
    elements: Iterable[Any],
    remedy: str = "",
) -> None:
    """Check that all names of a field are among the elements of an MJCF file."""
    known = {element.name for element in elements if element.name}
    for name in names:
        if name not in known:
            raise UserError(
                f"{owner}: {field} names {name!r}, which {mjcf.name} does not have. Its {kind}: "
                f"{', '.join(sorted(known)) or 'none'}.{remedy}"
            )
