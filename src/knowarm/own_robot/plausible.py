"""What no arm has and files state: ranges beyond a turn and a half, tables above the targets."""

import copy
import json
from collections.abc import Mapping, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from mujoco import MjModel, MjsBody, mj_ray, mjtGeom, mjtJoint

from knowarm.arrays import Floats
from knowarm.own_robot.draft_chain import box_corners, joint_names
from knowarm.own_robot.pixels import fixed_parts
from knowarm.own_robot.poses import robot_file, support_places
from knowarm.world.robots.robot import Robot
from knowarm.world.scene.compose import ROBOT_PREFIX
from knowarm.world.scene.mjcf import drawn, surroundings
from knowarm.world.scene.scene import Scene


class Kind(NamedTuple):
    """What ranges of a kind of joint are plausible."""

    unit: str
    most: float  # No arm's joint is farther from 0
    mistaken: float  # From which a range is one in another unit,
    scale: float  # of which this makes the right one
    usual: float  # Ends of a range to write down as an example


HINGE = Kind("rad", 3 * np.pi, 30.0, np.pi / 180, 3.14)
SLIDE = Kind("m", 5.0, 20.0, 0.001, 1.0)
SIDE = 5  # Places per side of the rectangle above which parts are searched
CLEARANCE_M = 0.01
RESTING_M = 0.03  # Farthest that a base stands above what bears it
SUNK_M = 0.1  # Farthest that it is drawn into that


def question_ranges(scene: Scene) -> tuple[str, str]:
    """Return what is wrong with the ranges of a scene's joints, and ``joint_ranges`` as TOML.

    Both are empty if no range is questionable.
    """
    texts = []
    likely = []
    limits = np.column_stack([scene.joint_lower, scene.joint_upper])
    for name, ends in zip(scene.joint_names, limits, strict=True):
        joint = scene.model.joint(ROBOT_PREFIX + name)
        kind = HINGE
        if joint.type[0] == mjtJoint.mjJNT_SLIDE:
            kind = SLIDE
        largest = np.abs(ends).max()
        if largest <= kind.most:
            continue
        low, high = ends
        texts.append(f"{name} [{low:.4g}, {high:.4g}] {kind.unit}")
        meant = ends.clip(-kind.usual, kind.usual)
        if largest > kind.mistaken:
            meant = ends * kind.scale
        likely.append(f"{json.dumps(name)} = {meant.round(4).tolist()}")
    if not texts:
        return "", ""
    question = (
        f"no arm turns by more than a turn and a half or slides by more than {SLIDE.most:.0f} m: "
        f"{', '.join(texts)}. Are these degrees or millimetres? Give the ranges of its data sheet"
    )
    return question, f"joint_ranges = {{{', '.join(likely)}}}"


def fixed_parts_above(scene: Scene) -> list[str]:
    """Name the parts of a robot's file that stand still above targets, below its highest joint."""
    data = scene.at(scene.home)
    model = copy.copy(scene.model)
    model.geom_group[:] = 1
    model.geom_group[fixed_parts(scene)] = 0
    looked_at = np.array([1, 0, 0, 0, 0, 0], np.uint8)  # Groups
    down = np.array([0.0, 0.0, -1.0])
    hit = np.zeros(1, np.int32)
    line = np.linspace(-1, 1, SIDE)
    top = data.xanchor[:, 2].max()
    names = []
    for x, y, z in support_places(scene, list(product(line, line))):
        start = np.array([x, y, top])
        way = mj_ray(model, data, start, down, looked_at, 1, -1, hit)
        if 0 <= way < top - z - CLEARANCE_M:
            geom = model.geom(hit[0])
            body = model.body(geom.bodyid[0]).name.removeprefix(ROBOT_PREFIX)
            name = geom.name.removeprefix(ROBOT_PREFIX) or f"a geom of body {body!r}"
            names.append(name)
    return list(dict.fromkeys(names))


def stands_on(robot: Robot, low_m: float) -> bool:
    """Return whether something of a robot's file that is left out bears it at a height [m]."""
    part = robot_file(robot)
    data = drawn(part)
    for element in surroundings(part, (*robot.joints, *robot.held_joints)):
        geoms = [element]
        if isinstance(element, MjsBody):
            geoms = element.find_all("geom")
        for geom in geoms:
            if geom.type == mjtGeom.mjGEOM_PLANE:
                top = data.geom_xpos[geom.id][2]
            else:
                top = box_corners(data, [geom.id])[..., 2].max()
            if -RESTING_M < top - low_m < SUNK_M:
                return True
    return False


def ranges_of(
    model: MjModel, given: Mapping[str, Sequence[float]]
) -> dict[str, Floats]:
    """Return the ranges of a file's joints by name, in place of some those that are given."""
    names = joint_names(model, range(model.njnt))
    ranges = dict(zip(names, model.jnt_range, strict=True))
    for name, ends in given.items():
        ranges[name] = np.array(ends, float)
    return ranges
