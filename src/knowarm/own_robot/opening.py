"""Opening of two fingers: the gap between their tips, and the joint values that make it widest."""

import copy
from collections.abc import Iterable, Sequence
from itertools import product
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from mujoco import MjData, MjModel, mj_kinematics, mj_name2id, mjtEq, mjtObj
from numpy.linalg import norm

from knowarm.arrays import Floats
from knowarm.check import Check
from knowarm.own_robot.draft_chain import (
    Ids,
    geoms_of,
    is_slide,
    joint_names,
    joints_of,
)
from knowarm.own_robot.poses import robot_file
from knowarm.world.robots.robot import Robot
from knowarm.world.scene.surface import surface_points

TIP_M = 0.03  # Most length of a finger's tip
TIP_SHARE = 0.5  # Most of a finger that is its tip
SAME_M = 0.001  # Gaps that differ by less are equal
LEAST_M = 0.005  # Of a gripper that is open
MOST_M = 0.5  # Of any gripper
LEAST_SHARE = 0.5  # Of the widest gap, at which fingers count as drawn open


class Opening(NamedTuple):
    """Two fingers that are open."""

    gap_m: float  # Between their tips
    middle_m: float  # Of that gap, from the world's origin across the hand
    joints: dict[str, float]  # Values of their joints by name


def finger_gap(data: MjData, fingers: list[Ids], frame: Floats) -> tuple[float, float]:
    """Return the gap between the tips of two fingers, and its middle across the hand [m].

    ``fingers`` are their geoms. The columns of ``frame`` (3, 3), world, are any direction, that
    across the hand in which the fingers open, and that out of the hand.
    """
    model = data.model
    spans = []
    for geoms in fingers:
        solid = [geom for geom in geoms if model.geom_contype[geom] != 0]
        surfaces = [surface_points(data, geom) for geom in solid or geoms]
        spans.append(np.concatenate(surfaces) @ frame[:, 1:])
    lengths = np.concatenate(spans)[:, 1]
    end = lengths.max()
    tip_m = min(TIP_M, TIP_SHARE * np.ptp(lengths))
    sides = []
    for points in spans:
        across, along = points.T
        tip = across[along > end - tip_m]
        if not len(tip):
            tip = across
        sides.append(tip)
    low, high = sides
    if low.min() - high.max() > high.min() - low.max():
        low, high = sides[::-1]
    return float(high.min() - low.max()), float(high.min() + low.max()) / 2


def widest_opening(
    drawn: MjData, joints: Ids, fingers: list[Ids], frame: Floats
) -> Opening | None:
    """Return the widest opening of two fingers at the ends of their slides.

    None if a slide has no end. The gap is negative where the tips overlap.
    Where fingers could pass through each other, the one counts in which each is on the side on
    which its slide begins.
    """
    data = copy.copy(drawn)
    model = data.model
    address = model.jnt_qposadr[joints]
    moved = data.qpos[address] - model.qpos0[address]
    begins = data.xpos[model.jnt_bodyid[joints]] - data.xaxis[joints] * moved[:, None]
    between = begins[0] - begins[1]
    across = frame[:, 1]
    side = between @ across
    one, other = fingers
    openings = []
    for ends in _ends(model, joints):
        values = np.round(ends, 5)
        data.qpos[address] = values
        mj_kinematics(model, data)
        gap, middle = finger_gap(data, fingers, frame)
        apart = data.geom_xpos[one].mean(axis=0) - data.geom_xpos[other].mean(axis=0)
        is_apart = norm(between) < SAME_M or apart @ across * side > 0
        named = dict(zip(joint_names(model, joints), values.tolist(), strict=True))
        openings.append((round(gap / SAME_M), is_apart, Opening(gap, middle, named)))
    if not openings:
        return None
    *_, opening = max(openings, key=lambda row: row[:2])
    return opening


def _ends(model: MjModel, joints: Ids) -> Iterable[Sequence[float]]:
    """Return the values of two joints at the ends of their ranges; coupled ones go together."""
    at_zero = model.qpos0[model.jnt_qposadr]
    for row in np.flatnonzero(model.eq_type == mjtEq.mjEQ_JOINT):
        follower = int(model.eq_obj1id[row])
        leader = int(model.eq_obj2id[row])
        if {follower, leader} == {*joints} and model.jnt_limited[leader]:
            ends = model.jnt_range[leader]
            follow = np.polynomial.Polynomial(model.eq_data[row, :5])
            followed = at_zero[follower] + follow(ends - at_zero[leader])
            values = {leader: ends, follower: followed}
            return np.column_stack(itemgetter(*joints)(values))
    if not model.jnt_limited[joints].all():
        return ()
    return product(*model.jnt_range[joints])


def check_fingers(robot: Robot) -> Check:
    """Check that the fingers of a description are drawn open."""
    part = robot_file(robot)
    if robot.tcp_body is not None:
        body = part.body(robot.tcp_body)
        body.add_site(name=robot.tcp_site, quat=robot.tcp_quaternion)
    model = part.compile()
    data = MjData(model)
    for name, value in robot.held_joints.items():
        data.joint(name).qpos = value
    mj_kinematics(model, data)
    fingers: list[Ids] = []
    slides: Ids = []
    for name in robot.fingers:
        body = mj_name2id(model, mjtObj.mjOBJ_BODY, name)
        if body >= 0:
            fingers.append(geoms_of(model, [body]).tolist())
            joints = joints_of(model, [model.body_weldid[body]])
            slides += [j for j in joints if is_slide(model, j)]
        else:
            geom = mj_name2id(model, mjtObj.mjOBJ_GEOM, name)
            fingers.append([geom] if geom >= 0 else [])
    names = " and ".join(robot.fingers)
    if len(fingers) != 2 or not all(fingers):
        return Check(
            "fingers",
            False,
            f"{names or 'none'} of {robot.mjcf.name}",
            "Name two bodies with geoms, or two geoms.",
        )
    frame = data.site(robot.tcp_site).xmat.reshape(3, 3)
    drawn, middle = finger_gap(data, fingers, frame)
    found = f"{names} are drawn {100 * drawn:.1f} cm apart"
    best = None
    if len(slides) == 2:
        best = widest_opening(data, slides, fingers, frame)
    widest, _, values = best or Opening(drawn, middle, {})
    if drawn >= min(LEAST_SHARE * widest, widest - SAME_M):
        remedy = "Open them in the file, or with held_joints."
        return Check("fingers", drawn >= LEAST_M, found, remedy)
    held = ", ".join(f"{name} = {value:g}" for name, value in values.items())
    return Check(
        "fingers",
        False,
        f"{found}, and {100 * widest:.1f} cm at the other end",
        f"Draw them open: held_joints = {{ {held} }}.",
    )
