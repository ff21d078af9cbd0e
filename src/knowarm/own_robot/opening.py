"""Opening of two fingers: the gap between their tips, and the joint values that make it widest."""

from collections.abc import Iterator, Mapping
from itertools import product
from typing import NamedTuple

import mujoco
import numpy as np
from mujoco import MjData, MjModel
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
from knowarm.world.robots.robot import Robot
from knowarm.world.scene.mjcf import read_mjcf
from knowarm.world.scene.surface import surface_points

TIP_M = 0.03  # Length of a finger's tip
SAME_M = 0.001  # Gaps that differ by less are equal
LEAST_M = 0.005  # Of a gripper that is open
LEAST_SHARE = 0.5  # Of the widest gap, at which fingers count as drawn open


class Opening(NamedTuple):
    """A gap between two fingers."""

    gap_m: float  # Between the tips, negative where they overlap [m]
    values: Mapping[str, float]  # Of the fingers' joints, by name [m]


def finger_gap(data: MjData, fingers: list[Ids], frame: Floats) -> float:
    """Return the gap between the tips of two fingers, of which the geoms are given [m].

    The columns of ``frame`` (3, 3), world, are any direction, that across the hand in which the
    fingers open, and that out of the hand.
    """
    model = data.model
    spans = []
    for geoms in fingers:
        solid = [geom for geom in geoms if model.geom_contype[geom] != 0]
        surfaces = [surface_points(data, geom) for geom in solid or geoms]
        spans.append(np.concatenate(surfaces) @ frame[:, 1:])
    end = np.concatenate(spans)[:, 1].max()
    sides = []
    for points in spans:
        tip = points[points[:, 1] > end - TIP_M, 0]
        if not len(tip):
            tip = points[:, 0]
        sides.append(tip)
    one, other = sides
    return float(max(one.min() - other.max(), other.min() - one.max()))


def widest_opening(
    data: MjData, joints: Ids, fingers: list[Ids], frame: Floats
) -> Opening | None:
    """Return the widest opening at the ends of two fingers' slides; None if one has no end.

    Where fingers could pass through each other, the one counts in which each is on its own side.
    """
    model = data.model
    names = joint_names(model, joints)
    address = model.jnt_qposadr[joints]
    at_first = data.qpos.copy()
    best = None
    for values in _ends(model, joints):
        data.qpos[address] = values
        mujoco.mj_kinematics(model, data)
        gap = finger_gap(data, fingers, frame)
        key = (round(gap / SAME_M), _is_apart(data, joints, fingers, frame))
        if best is None or key > best[0]:
            best = (key, Opening(gap, dict(zip(names, values, strict=True))))
    data.qpos[:] = at_first
    mujoco.mj_kinematics(model, data)
    return None if best is None else best[1]


def _is_apart(data: MjData, joints: Ids, fingers: list[Ids], frame: Floats) -> bool:
    """Return whether each finger is on the side on which its slide begins."""
    model = data.model
    address = model.jnt_qposadr[joints]
    moved = data.qpos[address] - model.qpos0[address]
    begins = data.xpos[model.jnt_bodyid[joints]] - data.xaxis[joints] * moved[:, None]
    if norm(begins[0] - begins[1]) < SAME_M:
        return True
    one, other = fingers
    apart = data.geom_xpos[one].mean(axis=0) - data.geom_xpos[other].mean(axis=0)
    across = frame[:, 1]
    return bool(apart @ across * ((begins[0] - begins[1]) @ across) > 0)


def _ends(model: MjModel, joints: Ids) -> Iterator[list[float]]:
    """Yield the values of two joints at the ends of their ranges; coupled ones go together."""
    first, second = joints
    for follower, leader in ((first, second), (second, first)):
        polynomial = _coupling(model, follower, leader)
        if polynomial is not None and model.jnt_limited[leader]:
            for end in model.jnt_range[leader].tolist():
                change = end - model.qpos0[model.jnt_qposadr[leader]]
                value = model.qpos0[model.jnt_qposadr[follower]]
                value += np.polynomial.Polynomial(polynomial)(change)
                values = {leader: round(end, 5), follower: round(float(value), 5)}
                yield [values[first], values[second]]
            return
    if model.jnt_limited[joints].all():
        ends = model.jnt_range[joints].round(5).tolist()
        for one, other in product(*ends):
            yield [one, other]


def _coupling(model: MjModel, follower: int, leader: int) -> Floats | None:
    """Return the coefficients of the polynomial by which a joint follows another, or None."""
    pair = (model.eq_obj1id == follower) & (model.eq_obj2id == leader)
    rows = np.flatnonzero(pair & (model.eq_type == mujoco.mjtEq.mjEQ_JOINT))
    return model.eq_data[rows[0], :5] if len(rows) else None


def check_fingers(robot: Robot) -> Check:
    """Check that the fingers of a description are drawn open."""
    model = read_mjcf(robot.mjcf, f"Robot {robot.name!r}").compile()
    data = MjData(model)
    for name, value in robot.held_joints.items():
        data.joint(name).qpos = value
    mujoco.mj_kinematics(model, data)
    bodies = [model.body(b).name for b in range(model.nbody)]
    fingers: list[Ids] = []
    slides: Ids = []
    for name in robot.fingers:
        if name in bodies:
            fingers.append(geoms_of(model, [bodies.index(name)]).tolist())
            moved = int(model.body_weldid[bodies.index(name)])
            joints = joints_of(model, [moved])
            slides += [j for j in joints if is_slide(model, j)]
        else:
            fingers.append([model.geom(name).id])
    names = " and ".join(robot.fingers)
    if len(fingers) != 2 or not all(fingers):
        return Check(
            "fingers",
            False,
            f"{names or 'none'} of {robot.mjcf.name}",
            "Name two bodies with geoms, or two geoms.",
        )
    frame = _tcp_frame(data, robot)
    drawn = finger_gap(data, fingers, frame)
    found = f"{names} are drawn {100 * drawn:.1f} cm apart"
    best = None
    if len(slides) == 2:
        best = widest_opening(data, slides, fingers, frame)
    if best is None or drawn >= min(LEAST_SHARE * best.gap_m, best.gap_m - SAME_M):
        remedy = "Open them in the file, or with held_joints."
        return Check("fingers", drawn >= LEAST_M, found, remedy)
    values = ", ".join(f"{name} = {value:g}" for name, value in best.values.items())
    return Check(
        "fingers",
        False,
        f"{found}, and {100 * best.gap_m:.1f} cm at the other end",
        f"Draw them open: held_joints = {{ {values} }}.",
    )


def _tcp_frame(data: MjData, robot: Robot) -> Floats:
    """Return the rotation of the tool centre point to world, (3, 3)."""
    if robot.tcp_body is None:
        return np.asarray(data.site(robot.tcp_site).xmat.reshape(3, 3))
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, np.array(robot.tcp_quaternion))
    return np.asarray(data.body(robot.tcp_body).xmat.reshape(3, 3) @ turn.reshape(3, 3))
