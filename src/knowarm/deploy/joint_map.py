"""Joint map of a robot's description, resolved for the contract: value = scale * angle + offset."""

import math
from pathlib import Path
from typing import Any

import mujoco

from knowarm.config import override
from knowarm.errors import UserError
from knowarm.reading import read_toml
from knowarm.world.robots.robot import RealJoint
from knowarm.world.scene.mjcf import check_names, read_mjcf
from knowarm.world.scene.scene import Scene


def real_joints(scene: Scene, file: Path | None = None) -> list[dict[str, Any]]:
    """Return joint, name, unit, scale and offset of each joint of the real arm, in its order.

    Joints that the map does not name, such as fingers that lift, follow as the model has them.

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
    limits, held = dict(zip(scene.joint_names, ranges, strict=True)), dict(robot.held_joints)
    types = dict(zip(scene.model.jnt_qposadr, scene.model.jnt_type, strict=True))
    places = zip(scene.joint_names, scene.qpos_index, strict=True)
    slides = [name for name, place in places if types[place] == mujoco.mjtJoint.mjJNT_SLIDE]
    if others := [name for name in robot.joint_map if name not in limits]:
        owner = f"Robot {robot.name!r}"
        part = read_mjcf(robot.mjcf, owner)
        check_names(owner, "joint_map", others, robot.mjcf, "joints", part.joints)
        model = part.compile()
        limits |= {name: tuple(model.joint(name).range) for name in others}
        held = {name: float(model.joint(name).qpos0[0]) for name in others} | held
    same = {name: RealJoint() for name in scene.joint_names if name not in robot.joint_map}
    entries = []
    for joint, real in {**robot.joint_map, **same}.items():
        lower, upper = map(float, limits[joint])
        scale, zero, unit = 1.0, 0.0, real.unit
        if unit == "deg":
            scale = math.degrees(1)
        elif unit != "rad":
            if lower >= upper:
                raise UserError(
                    f"joint_map.{joint}: {unit} is relative to the limits, which the model does "
                    "not state. Take rad or deg, with an offset."
                )
            low = -100.0 if unit == "range_m100_100" else 0.0
            scale = (100.0 - low) / (upper - lower)
            zero = low - scale * lower
        scale, offset = real.sign * scale, real.sign * zero + real.offset
        if joint in others:
            scale, offset = 0.0, offset + scale * held[joint]
        shown = "m" if joint in slides and unit == "rad" else unit
        entry = {"joint": joint, "name": real.name or joint, "unit": shown}
        entries.append(entry | {"scale": scale, "offset": offset})
    return entries
