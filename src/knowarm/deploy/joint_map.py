"""Joint map of a robot's description, resolved for the contract: value = scale * angle + offset."""

import math
from pathlib import Path
from typing import Any

import mujoco

from knowarm.config import override
from knowarm.errors import UserError
from knowarm.reading import read_toml
from knowarm.world.robots.robot import FINGERS_JOINT, RealJoint
from knowarm.world.scene.mjcf import check_names, read_mjcf
from knowarm.world.scene.scene import Scene

TURNS = {
    "rad": 1.0,
    "deg": math.degrees(1),
}
"""Scales of units of the angle."""
RANGES = {
    "range_0_1": (0.0, 1.0),
    "range_0_100": (0.0, 100.0),
    "range_m100_100": (-100.0, 100.0),
}
"""Ends of units that are relative to a range."""


def real_joints(scene: Scene, file: Path | None = None) -> list[dict[str, Any]]:
    """Return joint, name, unit, scale and offset of each joint of the real arm, in its order.

    Joints that the map does not name, such as fingers that lift, follow as the model has them.
    Fingers that it names have ``limits`` of what is sent: open and closed, or the ends of their
    range. Where no task moves them, they are sent open.

    Args:
        scene: of the robot.
        file: TOML file whose table ``joint_map`` replaces that of the robot's description.

    Raises:
        UserError: the map does not fit the robot.
    """
    robot = scene.robot
    if file is not None:
        values = read_toml(file)
        if "joint_map" not in values:
            raise UserError(f"{str(file)!r} has no table joint_map.")
        robot = override(robot, {"joint_map": values["joint_map"]}, where=str(file))
    ranges = zip(scene.joint_lower, scene.joint_upper, strict=True)
    limits = dict(zip(scene.joint_names, ranges, strict=True))
    held = dict(robot.held_joints)
    held[FINGERS_JOINT] = 0.0
    # Where they stay open, any range will do.
    limits[FINGERS_JOINT] = (0.0, 1.0)
    if scene.fingers is not None:
        limits[FINGERS_JOINT] = (0.0, scene.fingers.closed_m)
    others = [name for name in robot.joint_map if name not in limits]
    if others:
        owner = f"Robot {robot.name!r}"
        part = read_mjcf(robot.mjcf, owner)
        check_names(owner, "joint_map", others, robot.mjcf, "joints", part.joints)
        model = part.compile()
        for name in others:
            limits[name] = tuple(model.joint(name).range)
            held.setdefault(name, float(model.joint(name).qpos0[0]))
        if scene.fingers is not None and FINGERS_JOINT not in robot.joint_map:
            raise UserError(
                f"{owner}: joint_map holds {', '.join(others)} still, and this task moves the "
                "fingers. Name them in place of their joints, such as fingers = {name = "
                '"gripper.pos", unit = "range_0_100"}.'
            )
    slides = [*_slides(scene), FINGERS_JOINT]
    fingers = robot.joint_map.get(FINGERS_JOINT)
    if fingers is not None and fingers.unit == "deg":
        raise UserError(
            "joint_map.fingers: deg is of joints that turn. Give rad, which counts metres of each "
            "finger, or range_0_1, range_0_100 or range_m100_100."
        )
    joints = dict.fromkeys((*robot.joint_map, *scene.joint_names), RealJoint())
    entries = []
    for joint, real in (joints | dict(robot.joint_map)).items():
        ends = real.range or limits[joint]
        scale, zero = _unit(joint, real.unit, *map(float, ends))
        factor = real.sign * real.scale
        scale *= factor
        offset = factor * zero + real.offset
        if joint not in scene.joint_names:  # The policy does not move it.
            offset += scale * held[joint]
            scale = 0.0
        entry = {
            "joint": joint,
            "name": real.name or joint,
            "unit": "m" if joint in slides and real.unit == "rad" else real.unit,
            "scale": scale,
            "offset": offset,
        }
        if scale and fingers is not None and joint == FINGERS_JOINT:
            # The policy's targets go on beyond closed.
            open_value = scale * ends[0] + offset
            closed_value = scale * ends[1] + offset
            entry["limits"] = sorted([open_value, closed_value])
        entries.append(entry)
    return entries


def _slides(scene: Scene) -> list[str]:
    """Return the names of the joints that are moved along, not turned."""
    is_slide = scene.model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE
    addresses = scene.model.jnt_qposadr[is_slide]
    joints = zip(scene.joint_names, scene.qpos_index, strict=True)
    return [name for name, address in joints if address in addresses]


def _unit(joint: str, unit: str, lower: float, upper: float) -> tuple[float, float]:
    """Return scale and zero of a unit: value = scale * angle + zero, with the angle in radians."""
    if unit in TURNS:
        return TURNS[unit], 0.0
    if lower >= upper:
        raise UserError(
            f"joint_map.{joint}: {unit} is relative to the limits, which the model does "
            "not state. Give range, such as range = [-1.5, 1.5], or take rad or deg, with an "
            "offset."
        )
    low, high = RANGES[unit]
    scale = (high - low) / (upper - lower)
    return scale, low - scale * lower
