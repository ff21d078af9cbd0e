"""Attachment of a robot's or target's MJCF file to the ``MjSpec`` of a scene."""

import math
import re
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from PIL import Image

from knowarm.errors import UserError
from knowarm.reading import one_line, reading
from knowarm.world.robot import Robot
from knowarm.world.target import Target

ROBOT_PREFIX = "robot/"
"""Prefix of all names of the robot's own file in the scene."""

MAX_PIXELS = 4096 * 4096
"""Most pixels of a texture, and most points of a height field."""

MAX_COPIES, MAX_INCLUDES = 10_000, 16
"""Most copies that replicating elements of an MJCF file make, and deepest inclusion of files."""

ROBOT_BIT, SUPPORT_BIT = 1, 2
"""MuJoCo contact bits: the only contacts are those between robot and support."""


def read_mjcf(path: Path, owner: str) -> mujoco.MjSpec:
    """Read an MJCF file.

    Args:
        path: the file.
        owner: the description that names the file, for messages ("Robot 'irb120'").

    Raises:
        UserError: the file is missing, or MuJoCo cannot read or compile it.
    """
    with reading(path, "Give the path of an MJCF file."):
        is_file = path.is_file()
    if not is_file:
        raise UserError(f"{owner}: mjcf is {str(path)!r}, and there is no such file.")
    try:
        _check_text(path, owner)
        spec = mujoco.MjSpec.from_file(str(path))
        _check_sizes(spec, path, owner)
        spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        if isinstance(error, UserError):
            raise
        reason = one_line(error)
        raise UserError(
            f"{owner}: mjcf {str(path)!r} does not compile: {reason}. Correct the file; "
            f"`python -m mujoco.viewer --mjcf={path}` shows the same error."
        ) from None
    return spec


def _check_text(path: Path, owner: str, depth: int = 0) -> None:
    """Refuse what takes gigabytes while MuJoCo reads it: repetitions and height fields.

    Raises:
        UserError: a ``count`` or a height field is too large, or files include each other too
            deeply.
    """
    with reading(path, "Give the path of an MJCF file."):
        text = path.read_bytes()
    total = 1
    for found in re.finditer(rb"count\s*=\s*[\"']([^\"']*)[\"']", text):
        for word in found[1].split():
            total *= max(1, int(word)) if word.isdigit() else 1
    if total > MAX_COPIES:
        raise UserError(
            f"{owner}: mjcf {str(path)!r} repeats elements {total:,} times, and at most "
            f"{MAX_COPIES:,} copies are read. Reduce the attributes count."
        )
    for found in re.finditer(rb"<hfield\s[^>]*", text):
        sides = re.findall(rb"\b(?:nrow|ncol)\s*=\s*[\"']\s*(\d+)", found[0])
        if (size := math.prod(map(int, sides))) > MAX_PIXELS:
            raise _too_large(owner, path, "a height field", size)
    for found in re.finditer(rb"<include\s[^>]*file\s*=\s*[\"']([^\"']*)[\"']", text):
        included = path.parent / found[1].decode(errors="replace")
        if depth > MAX_INCLUDES:
            raise UserError(f"{owner}: mjcf {str(path)!r} includes files too deeply.")
        if included.is_file():
            _check_text(included, owner, depth + 1)


def _check_sizes(spec: mujoco.MjSpec, path: Path, owner: str) -> None:
    """Refuse textures, height fields and buffers that would take gigabytes.

    Raises:
        UserError: one of them is too large.
    """
    # A cube texture has six square faces; MuJoCo takes its height from the width.
    sizes = {f"texture {t.name!r}": t.width * max(t.height, t.width) for t in spec.textures}
    for texture in spec.textures:
        file = path.parent / spec.texturedir / texture.file
        if texture.file and file.suffix.lower() == ".png":
            with suppress(OSError, Image.DecompressionBombError), Image.open(file) as image:
                sizes[f"texture {texture.name!r}"] = image.width * image.height
    sizes |= {f"height field {h.name!r}": h.nrow * h.ncol for h in spec.hfields}
    sizes["memory"] = max(0, spec.memory) // 16
    sizes |= {
        name: getattr(spec, name)
        for name in dir(spec)
        if name.startswith("nuser") and isinstance(getattr(spec, name), int)
    }
    for name, size in sizes.items():
        if size > MAX_PIXELS:
            raise _too_large(owner, path, name, size)


def _too_large(owner: str, path: Path, name: str, size: int) -> UserError:
    return UserError(
        f"{owner}: mjcf {str(path)!r}: {name} has {size:,} elements, and at most "
        f"{MAX_PIXELS:,} are read. Reduce its size."
    )


def attach_robot(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Attach the robot, gravity compensated, with only the joints that the agent moves.

    Raises:
        UserError: the file does not compile, or lacks a named joint, body or site.
    """
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
    """Attach a target as a mocap body without physics, at its yaw.

    Raises:
        UserError: the file does not compile, holds more than one body, or lacks a named part.
    """
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
    """Check that all names of a field are among the elements of an MJCF file.

    Raises:
        UserError: a name is missing; the message lists those of its kind and adds ``remedy``.
    """
    known = {element.name for element in elements if element.name}
    for name in names:
        if name not in known:
            raise UserError(
                f"{owner}: {field} names {name!r}, which {mjcf.name} does not have. Its {kind}: "
                f"{', '.join(sorted(known)) or 'none'}.{remedy}"
            )
