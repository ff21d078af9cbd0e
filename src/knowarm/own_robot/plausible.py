"""What no arm has and files state: ranges beyond a turn and a half, tables above the targets."""

import json
from collections.abc import Mapping, Sequence
from itertools import product

import mujoco
import numpy as np

from knowarm.arrays import Floats
from knowarm.own_robot.pixels import robot_parts
from knowarm.own_robot.poses import rectangle_places
from knowarm.world.robots.robot import Robot
from knowarm.world.scene.compose import ROBOT_PREFIX
from knowarm.world.scene.mjcf import read_mjcf, surroundings
from knowarm.world.scene.scene import Scene, target_places

MOST_RAD = 3 * np.pi
"""A hinge that turns farther from 0 has a wrong range."""

MOST_M = 5.0  # A slide that is longer has one
DEGREES = 30.0  # From which a range of hinges is one in degrees
MILLIMETRES = 20.0  # From which a range of slides is one in millimetres
USUAL_RAD = 3.14  # A range to write down as an example
SIDE = 5  # Places per side of the rectangle above which parts are searched
CLEARANCE_M = 0.01
HIGH_M = 100.0  # From where it is looked down
RESTING_M = 0.03  # Farthest that a base stands above what bears it
SUNK_M = 0.1  # Farthest that it is drawn into that


def question_ranges(scene: Scene) -> tuple[str, str]:
    """Return what is wrong with the ranges of a scene's joints, and ``joint_ranges`` as TOML.

    Both are empty if no range is questionable.
    """
    robot = scene.robot
    texts = []
    likely = []
    limits = zip(scene.joint_lower, scene.joint_upper, strict=True)
    for name, (low, high) in zip(robot.joints, limits, strict=True):
        joint = scene.model.joint(ROBOT_PREFIX + name)
        is_slide = joint.type[0] == mujoco.mjtJoint.mjJNT_SLIDE
        most = MOST_M if is_slide else MOST_RAD
        if max(-low, high) > most:
            texts.append(f"{name} [{low:.4g}, {high:.4g}] {'m' if is_slide else 'rad'}")
            likely.append(f"{json.dumps(name)} = {_likely(low, high, is_slide)}")
    if not texts:
        return "", ""
    question = (
        f"no arm turns by more than a turn and a half or slides by more than {MOST_M:.0f} m: "
        f"{', '.join(texts)}. Are these degrees or millimetres? Give the ranges of its data sheet"
    )
    return question, f"joint_ranges = {{{', '.join(likely)}}}"


def _likely(low: float, high: float, is_slide: bool) -> list[float]:
    """Return the range that may be meant: of degrees or millimetres, else a usual one."""
    ends = np.array([low, high])
    largest = np.abs(ends).max()
    if is_slide and largest > MILLIMETRES:
        ends = ends / 1000
    elif is_slide:
        ends = ends.clip(-1, 1)
    elif largest > DEGREES:
        ends = np.radians(ends)
    else:
        ends = ends.clip(-USUAL_RAD, USUAL_RAD)
    likely: list[float] = ends.round(4).tolist()
    return likely


def fixed_parts_above(scene: Scene) -> list[str]:
    """Name the parts of a robot's file that stand still above targets, below its highest joint."""
    data = scene.at(scene.home)
    model = scene.model
    joints = [model.joint(ROBOT_PREFIX + name).id for name in scene.joint_names]
    highest = data.xanchor[joints, 2].max()
    line = np.linspace(-1, 1, SIDE)
    signs = list(product(line, line))
    places = target_places(scene, rectangle_places(scene.robot, signs))
    is_fixed = model.body_weldid[model.geom_bodyid] == 0
    names = []
    for geom in np.flatnonzero(robot_parts(scene) & is_fixed).tolist():
        for place in places:
            top = _top_m(data, geom, place)
            if place[2] + CLEARANCE_M < top < highest:
                body = model.body(model.geom_bodyid[geom]).name.removeprefix(
                    ROBOT_PREFIX
                )
                name = model.geom(geom).name or f"a geom of body {body!r}"
                names.append(name.removeprefix(ROBOT_PREFIX))
                break
    return list(dict.fromkeys(names))


def _top_m(data: mujoco.MjData, geom: int, place: Floats) -> float:
    """Return the height of a geom's surface above a place (3,) [m]; -inf if it is not there."""
    model = data.model
    start = np.array([place[0], place[1], HIGH_M])
    down = np.array([0.0, 0.0, -1.0])
    kind = model.geom_type[geom]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        way = mujoco.mj_rayMesh(model, data, geom, start, down, None)
    else:
        way = mujoco.mju_rayGeom(
            data.geom_xpos[geom],
            data.geom_xmat[geom],
            model.geom_size[geom],
            start,
            down,
            kind,
            None,
        )
    return HIGH_M - way if way >= 0 else -np.inf


def stands_on(robot: Robot, low_m: float) -> bool:
    """Return whether something of a robot's file that is left out bears it at a height [m]."""
    part = read_mjcf(robot.mjcf, f"Robot {robot.name!r}")
    model = part.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    geoms = []
    for element in surroundings(part, (*robot.joints, *robot.held_joints)):
        if isinstance(element, mujoco.MjsBody):
            geoms += element.find_all("geom")
        else:
            geoms.append(element)
    for geom in geoms:
        middle, half = model.geom_aabb[geom.id].reshape(2, 3)
        upward = data.geom_xmat[geom.id].reshape(3, 3)[2]
        top = data.geom_xpos[geom.id][2]
        if geom.type != mujoco.mjtGeom.mjGEOM_PLANE:
            top += upward @ middle + np.abs(upward) @ half
        if -RESTING_M < top - low_m < SUNK_M:
            return True
    return False


def ranges_of(
    model: mujoco.MjModel, given: Mapping[str, Sequence[float]]
) -> dict[str, Floats]:
    """Return the ranges of a file's joints by name, in place of some those that are given."""
    ranges = {model.joint(j).name: model.jnt_range[j] for j in range(model.njnt)}
    for name, ends in given.items():
        ranges[name] = np.array(ends, float)
    return ranges
