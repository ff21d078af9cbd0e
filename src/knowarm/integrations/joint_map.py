"""Joint map of a robot's description, resolved for the contract: value = scale * angle + offset."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from knowarm.config import from_dict
from knowarm.errors import UserError
from knowarm.reading import read_toml
from knowarm.world.robots.robot import RealJoint
from knowarm.world.scene.mjcf import check_names, read_mjcf
from knowarm.world.scene.scene import Scene


@dataclass(frozen=True)
class _File:
    joint_map: Mapping[str, RealJoint]


def real_joints(scene: Scene, file: Path | None = None) -> list[dict[str, Any]]:
    """Return the entries of the contract's ``joints.real``; none for a robot without a map.

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
        found = from_dict(_File, {"joint_map": values["joint_map"]}, where=str(file))
        robot = replace(robot, joint_map=found.joint_map)
    ranges = np.stack([scene.joint_lower, scene.joint_upper], 1)
    limits: dict[str, Any] = dict(zip(scene.joint_names, ranges, strict=True))
    held: dict[str, float] = {}
    if others := [name for name in robot.joint_map if name not in robot.joints]:
        owner = f"Robot {robot.name!r}"
        part = read_mjcf(robot.mjcf, owner)
        check_names(owner, "joint_map", others, robot.mjcf, "joints", part.joints)
        model = part.compile()
        limits |= {name: model.joint(name).range for name in others}
        held = {name: float(model.joint(name).qpos0[0]) for name in others}
        held |= robot.held_joints
    entries = []
    for joint, real in robot.joint_map.items():
        lower, upper = map(float, limits.get(joint, (0.0, 0.0)))
        scale, zero = 1.0, 0.0
        if real.unit == "deg":
            scale = math.degrees(1)
        elif real.unit != "rad":
            if lower >= upper:
                raise UserError(
                    f"joint_map.{joint}: {real.unit} is relative to the limits, which the model "
                    "does not state. Take rad or deg, with an offset."
                )
            low = -100.0 if real.unit == "range_m100_100" else 0.0
            scale = (100.0 - low) / (upper - lower)
            zero = low - scale * lower
        scale, offset = real.sign * scale, real.sign * zero + real.offset
        if joint not in robot.joints:
            scale, offset = 0.0, offset + scale * held[joint]
        entry = {"joint": joint, "name": real.name or joint, "unit": real.unit}
        entries.append(entry | {"scale": scale, "offset": offset})
    return entries


def joint_units(scene: Scene) -> dict[str, str]:
    """Return "rad" or "m" by name of each joint that the policy moves."""
    types = dict(zip(scene.model.jnt_qposadr, scene.model.jnt_type, strict=True))
    is_slide = [types[index] == mujoco.mjtJoint.mjJNT_SLIDE for index in scene.qpos_index]
    units = ("m" if slide else "rad" for slide in is_slide)
    return dict(zip(scene.joint_names, units, strict=True))
