"""Joint maps of real arms: from LeRobot's calibration file, or one unit for all joints."""

import json
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from knowarm.arrays import Floats
from knowarm.config import from_dict
from knowarm.errors import UserError
from knowarm.own_robot.poses import Fields
from knowarm.reading import read_json
from knowarm.world.robots.robot import RealJoint

TICKS = 4096  # Of a turn of the motors that LeRobot calibrates
POSITION = ".pos"  # Ends LeRobot's names of joint positions
GRIPPER_WORDS = re.compile("gripper|jaw", re.IGNORECASE)
"""Motors with these words in their names open from 0 to 100, in either of LeRobot's units."""

LEAST_SPAN_RAD = math.radians(10)  # Of a joint that was moved from end to end
MOST_MISSING_RAD = math.radians(0.5)  # At each end of a recorded range
REMEDY = "Give the JSON file that LeRobot wrote when the arm was calibrated."

Unit = Literal["rad", "deg", "range"]
"""Unit of an arm: radians, degrees, or LeRobot's ranges of its calibration."""


@dataclass(frozen=True, kw_only=True)
class Motor:
    """A motor of a calibration file."""

    id: int = 0
    """Number on the bus."""
    drive_mode: Literal[0, 1] = 0
    """1 where it counts the other way, which LeRobot or the motor corrects."""
    homing_offset: int = 0
    """Shift of its zero, which the motor applies itself [ticks]."""
    range_min: int
    """Lowest place of the joint [ticks]."""
    range_max: int
    """Highest place of the joint [ticks]."""

    def __post_init__(self) -> None:
        if not 0 <= self.range_min < self.range_max < TICKS:
            raise UserError(
                f"range_min {self.range_min} and range_max {self.range_max} must lie in 0 to "
                f"{TICKS - 1}, the lower one first. Calibrate the arm again."
            )

    @property
    def span_rad(self) -> float:
        """Angle between both ends of the range [rad]."""
        return (self.range_max - self.range_min) * 2 * math.pi / TICKS

    @property
    def turns(self) -> bool:
        """Whether the joint turns without end, so that its middle is where it was calibrated."""
        return self.range_max - self.range_min == TICKS - 1


def read_calibration(path: Path) -> dict[str, Motor]:
    """Read LeRobot's calibration of an arm: its motors by name."""
    values = read_json(path, remedy=REMEDY)
    motors = {}
    for name, fields in values.items():
        if not isinstance(fields, Mapping) or "range_min" not in fields:
            raise UserError(
                f"{path}: {name!r} has no range_min. Files of LeRobot before 0.3 lack it: "
                "calibrate the arm again with a newer one."
            )
        motor = from_dict(Motor, fields, where=f"{path}: {name}")
        if motor.span_rad < LEAST_SPAN_RAD:
            raise UserError(
                f"{path}: {name} was moved by {math.degrees(motor.span_rad):.1f} degrees when its "
                "range was recorded. Calibrate again, and move each joint from end to end."
            )
        motors[name] = motor
    if not motors:
        raise UserError(f"{path} has no motors. {REMEDY}")
    return motors


def lerobot_map(
    motors: Mapping[str, Motor],
    ranges: Mapping[str, Floats],
    names: Mapping[str, str],
    unit: Unit = "range",
) -> Fields:
    """Return the joint map of an arm that LeRobot drives, as the fields of its joints.

    LeRobot counts from the middle of the range that was recorded for the unit at hand. That is the
    middle of the model's range; of a gripper, the closed ends are the same, and of a joint that
    turns without end the middle is the model's zero.

    Args:
        motors: the calibration.
        ranges: limits of the model's joints by name [rad].
        names: names of motors by those of joints, where they differ.
        unit: "deg" if LeRobot was set to ``use_degrees``.

    Raises:
        UserError: motors are not joints of the model.
    """
    joints = {names.get(joint, joint): joint for joint in ranges}
    unknown = [motor for motor in motors if motor not in joints]
    if unknown:
        example = f'{{{next(iter(ranges))} = {{name = "{unknown[0]}{POSITION}"}}}}'
        raise UserError(
            f"The calibration has the motors {', '.join(unknown)}, which are no joints of the "
            f"model: {', '.join(ranges)}. Name the motors in the description, such as joint_map = "
            f"{example}."
        )
    entries: Fields = {}
    for name, motor in motors.items():
        joint = joints[name]
        entries[joint] = _entry(name, motor, ranges[joint], unit)
    return entries


def _entry(name: str, motor: Motor, limits: Floats, unit: Unit) -> Fields:
    """Return the fields of a joint whose motor is calibrated, and whose limits are the model's."""
    low, high = map(float, limits)
    span = motor.span_rad
    middle = 0.0 if motor.turns else (low + high) / 2
    entry: Fields = {"name": name + POSITION, "unit": "range_0_100"}
    if GRIPPER_WORDS.search(name):
        ends = (low, low + span)
    elif unit == "deg":
        scale = TICKS / (TICKS - 1)
        offset = round(-scale * math.degrees(middle), 3) + 0.0  # no -0.0
        return entry | {"unit": "deg", "scale": round(scale, 6), "offset": offset}
    else:
        entry["unit"] = "range_m100_100"
        ends = (middle - span / 2, middle + span / 2)
    return entry | {"range": [round(end, 5) for end in ends]}


def narrower_ranges(
    motors: Mapping[str, Motor], ranges: Mapping[str, Floats], names: Mapping[str, str]
) -> dict[str, list[float]]:
    """Return the ranges [rad] of joints that were recorded narrower than the model's.

    Beyond them LeRobot cuts off what it is sent. Arguments are those of `lerobot_map`.
    """
    narrower = {}
    for joint, (low, high) in ranges.items():
        name = names.get(joint, joint)
        if name not in motors or GRIPPER_WORDS.search(name):
            continue
        missing = (high - low - motors[name].span_rad) / 2
        if missing > MOST_MISSING_RAD:
            ends = [low + missing, high - missing]
            narrower[joint] = [round(float(end), 4) for end in ends]
    return narrower


def unit_map(joints: Iterable[str], unit: Unit) -> Fields:
    """Return the joint map of an arm that counts all joints in a unit, from the model's zero."""
    return {
        joint: {"name": joint, "sign": 1, "offset": 0.0, "unit": unit}
        for joint in joints
    }


def motor_names(joint_map: Mapping[str, RealJoint]) -> dict[str, str]:
    """Return the motors' names that a joint map gives, by those of the joints."""
    names = {}
    for joint, real in joint_map.items():
        if real.name:
            names[joint] = real.name.removesuffix(POSITION)
    return names


def joint_map_toml(entries: Mapping[str, Any]) -> str:
    """Return a joint map as a table in TOML's notation."""
    lines = ["[joint_map]"]
    for joint, entry in entries.items():
        values = ", ".join(
            f"{key} = {json.dumps(value)}" for key, value in entry.items()
        )
        lines.append(f"{json.dumps(joint)} = {{{values}}}")
    return "\n".join(lines) + "\n"
