"""Check of a joint map by motion: five degrees of each joint, and what the arm itself read."""

import csv
import math
from collections.abc import Iterator
from pathlib import Path

from mujoco import mjtJoint

from knowarm.arrays import Floats
from knowarm.check import Check
from knowarm.own_robot.calibration import TICKS
from knowarm.own_robot.plausible import ranges_of
from knowarm.own_robot.poses import robot_file
from knowarm.reading import read_text, reading
from knowarm.world.robots import find_robot
from knowarm.world.robots.robot import RealJoint
from knowarm.world.scene.mjcf import check_names

COMMANDED_DEG = 5.0
COMMANDED_M = 0.01  # Of a slide
MOST_ERROR = 0.04
"""Largest share by which a joint moves more or less than it was told to: .2 of five degrees."""

PER_DEGREE = {"deg": 1.0, "rad": math.radians(1), "ticks": TICKS / 360}
"""What one degree is in the units in which arms read their joints; slides read metres."""

COLUMNS = ("joint", "before", "after", "unit")
"""The model's joint, what the arm read before and after it was told to move, and in which unit. A
joint may have several rows, of which the mean counts."""

REMEDY = (
    f"Give the columns {', '.join(COLUMNS)}, with a unit of {', '.join(PER_DEGREE)}."
)


def check_moved_joints(robot: str, path: Path) -> Iterator[Check]:
    """Compare five degrees of each joint with what came back.

    A person or program tells each joint of the arm, one by one and through the joint map, to move
    by `COMMANDED_DEG` (slides: `COMMANDED_M`) in the model's positive direction. The CSV file
    ``path`` has the arm's own readings, in its own units, which the joint map did not make.
    """
    description = find_robot(robot)
    rows = _read(path)
    part = robot_file(description)
    check_names(
        f"Robot {description.name!r}",
        path.name,
        [joint for joint, _, _ in rows],
        description.mjcf,
        "joints",
        part.joints,
    )
    moved: dict[str, list[float]] = {}
    for joint, change, unit in rows:
        told = COMMANDED_DEG * PER_DEGREE[unit]
        if part.joint(joint).type == mjtJoint.mjJNT_SLIDE:
            told = COMMANDED_M
        moved.setdefault(joint, []).append(change / told)
    missing = [name for name in description.joints if name not in moved]
    yield Check(
        "moved joints",
        not missing,
        f"{len(moved)} joints in {path}",
        f"Move the others too: {', '.join(missing)}.",
    )
    ranges = ranges_of(part.compile(), description.joint_ranges)
    for name, ratios in moved.items():
        real = description.joint_map.get(name, RealJoint())
        ratio = real.sign * sum(ratios) / len(ratios)
        yield _check_ratio(name, real, ratio, ranges[name])


def _read(path: Path) -> list[tuple[str, float, str]]:
    """Read the joints of a file of moved joints, each with its change and unit."""
    text = read_text(path, remedy=REMEDY)
    rows = []
    with reading(path, REMEDY):
        for row in csv.DictReader(text.splitlines()):
            change = float(row["after"]) - float(row["before"])
            if row["unit"] not in PER_DEGREE or not math.isfinite(change):
                raise ValueError(f"{row} has no finite readings in a known unit")
            rows.append((row["joint"], change, row["unit"]))
        if not rows:
            raise ValueError("it has no rows")
    return rows


def _check_ratio(name: str, real: RealJoint, ratio: float, limits: Floats) -> Check:
    """Check how many times as far as it was told a joint moved."""
    low, high = map(float, real.range or limits)
    if ratio < 0:
        remedy = f"It moves the other way: joint_map.{name}.sign = {-real.sign}."
    elif ratio < MOST_ERROR:
        remedy = "It did not move: switch the motor on, and wait until it has moved."
    elif real.unit.startswith("range"):
        wider = (ratio - 1) * (high - low) / 2
        ends = [round(low - wider, 4), round(high + wider, 4)]
        remedy = f"Its range is another: joint_map.{name}.range = {ends}."
    else:
        scale = real.scale / ratio
        remedy = f"It counts otherwise: joint_map.{name}.scale = {scale:.4f}, or another unit."
    found = f"moved {ratio:.3f} times as far as it was told"
    return Check(f"joint {name}", abs(ratio - 1) <= MOST_ERROR, found, remedy)
