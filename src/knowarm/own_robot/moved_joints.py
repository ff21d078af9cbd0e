"""Check of a joint map by motion: five degrees of each joint, and what the arm itself read."""

import csv
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from mujoco import MjSpec, mjtJoint

from knowarm.arrays import Floats
from knowarm.check import Check
from knowarm.errors import UserError
from knowarm.own_robot.calibration import TICKS
from knowarm.own_robot.plausible import ranges_of
from knowarm.own_robot.poses import robot_file
from knowarm.reading import read_text, reading
from knowarm.world.objects import find_targets
from knowarm.world.robots import find_robot
from knowarm.world.robots.robot import FINGERS_JOINT, RealJoint, Robot
from knowarm.world.scene.mjcf import check_names
from knowarm.world.tasks.skills import SKILLS

MOST_ERROR = 0.04
"""Largest share by which a joint moves more or less than commanded: .2 of five degrees."""

TURNED = {"deg": 5.0, "rad": math.radians(5), "ticks": 5 * TICKS / 360}
"""Commanded motion of a hinge, in the units in which arms read it."""

SLID = {"m": 0.01, "mm": 10.0}
"""Commanded motion of a slide, and of each finger."""

COLUMNS = ("joint", "before", "after", "unit")
"""The model's joint, what the arm read before and after the command to move, and in which unit. A
joint may have several rows, of which the mean counts."""

REMEDY = (
    f"Give the columns {', '.join(COLUMNS)}, with a unit of {', '.join(TURNED)} where a joint "
    f"turns, {', '.join(SLID)} where it slides."
)


def check_moved_joints(robot: str, path: Path) -> Iterator[Check]:
    """Compare five degrees of each joint with what came back.

    A person or program tells each joint of the arm, one by one and through the joint map, to move
    as `TURNED` and `SLID` say, in the model's positive direction: fingers closed. The CSV file
    ``path`` has the arm's own readings, in its own units, which the joint map did not make.
    """
    description = find_robot(robot)
    rows = _read(path)
    part = robot_file(description)
    moved: dict[str, list[float]] = {}
    for joint, change, unit in rows:
        kind, units = _kind(description, part, path, joint)
        if unit not in units:
            raise UserError(f"{path}: {joint!r} {kind}, and {unit} does not. {REMEDY}")
        moved.setdefault(joint, []).append(change / units[unit])
    wanted = dict.fromkeys(description.joints)
    if FINGERS_JOINT in description.joint_map:
        wanted[FINGERS_JOINT] = None
    missing = [name for name in wanted if name not in moved]
    yield Check(
        "moved joints",
        not missing,
        f"{len(moved)} joints in {path}",
        f"Move the others too: {', '.join(missing)}.",
    )
    ranges = ranges_of(part.compile(), description.joint_ranges)
    if FINGERS_JOINT in moved:
        ranges[FINGERS_JOINT] = np.array([0.0, _closed_m(description)])
    for name, ratios in moved.items():
        real = description.joint_map.get(name, RealJoint())
        ratio = sum(ratios) / len(ratios)
        if name != FINGERS_JOINT:  # whose way is measured, and counted as in the model
            ratio *= real.sign
        yield _check_ratio(name, real, ratio, ranges[name])


def _closed_m(robot: Robot) -> float:
    """Return how far each finger closes in a skill that moves them [m]."""
    skills = [kind() for kind in SKILLS.types()]
    skill = next(skill for skill in skills if skill.moves_fingers)
    scene = skill.build_scene(robot, find_targets(skill.targets), 0)
    assert scene.fingers is not None
    return scene.fingers.closed_m


def _kind(
    robot: Robot, part: MjSpec, path: Path, joint: str
) -> tuple[str, dict[str, float]]:
    """Return whether a joint turns or slides, in words, and what it is told by unit."""
    if joint == FINGERS_JOINT and robot.fingers:
        return "slide", SLID
    owner = f"Robot {robot.name!r}"
    check_names(owner, path.name, [joint], robot.mjcf, "joints", part.joints)
    if part.joint(joint).type == mjtJoint.mjJNT_SLIDE:
        return "slides", SLID
    return "turns", TURNED


def _read(path: Path) -> list[tuple[str, float, str]]:
    """Read the joints of a file of moved joints, each with its change and unit."""
    text = read_text(path, remedy=REMEDY)
    rows = []
    with reading(path, REMEDY):
        for row in csv.DictReader(text.splitlines()):
            change = float(row["after"]) - float(row["before"])
            if row["unit"] not in TURNED | SLID or not math.isfinite(change):
                raise ValueError(f"{row} has no finite readings in a known unit")
            rows.append((row["joint"], change, row["unit"]))
        if not rows:
            raise ValueError("it has no rows")
    return rows


def _check_ratio(name: str, real: RealJoint, ratio: float, limits: Floats) -> Check:
    """Check how many times as far as commanded a joint moved."""
    low, high = map(float, real.range or limits)
    if ratio < 0:
        remedy = f"It moves the other way: joint_map.{name}.sign = {-real.sign}"
        if name == FINGERS_JOINT:
            remedy += ", with the offset of what it reads open"
        remedy += "."
    elif ratio < MOST_ERROR:
        remedy = "It did not move: switch the motor on, and wait until it has moved."
    elif real.unit.startswith("range"):
        wider = (ratio - 1) * (high - low)
        if name != FINGERS_JOINT:  # which begin open
            wider /= 2
            low -= wider
        ends = [round(low, 4), round(high + wider, 4)]
        remedy = f"Its range is another: joint_map.{name}.range = {ends}."
    else:
        scale = real.scale / ratio
        remedy = f"It counts otherwise: joint_map.{name}.scale = {scale:.4f}, or another unit."
    found = f"moved {ratio:.3f} times as far as commanded"
    return Check(f"joint {name}", abs(ratio - 1) <= MOST_ERROR, found, remedy)
