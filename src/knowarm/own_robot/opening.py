"""Opening of two fingers: the gap between the surfaces that meet, where it is widest."""

import copy
from collections.abc import Mapping, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from mujoco import (
    MjData,
    MjModel,
    mj_fwdPosition,
    mj_kinematics,
    mj_name2id,
    mjtDisableBit,
    mjtEq,
    mjtJacobian,
    mjtObj,
    mjtTrn,
)
from numpy.linalg import matrix_rank, norm

from knowarm.arrays import Floats, Integers, Mask
from knowarm.check import Check
from knowarm.own_robot.draft_chain import (
    MOVABLE,
    Ids,
)
from knowarm.own_robot.poses import robot_file
from knowarm.world.robots.robot import Robot
from knowarm.world.scene.surface import solid_geoms, surface_points

TIP_M = 0.03  # Most length of a finger's tip
TIP_SHARE = 0.5  # Most of a finger that is its tip
SAME_M = 0.001  # Gaps that differ by less are equal
MEET_M = 0.003  # Surfaces that are so near where the gripper is closed meet
LEAST_M = 0.005  # Of a gripper that is open
MOST_M = 0.5  # Of any gripper
LEAST_SHARE = 0.5  # Of the widest gap, at which fingers count as drawn open
MOST_DRIVERS = 2  # Joints that move two fingers without being coupled
STEPS = 20  # In which a joint is moved to its end
ITERATIONS = 20  # Of Newton's method at each
CLOSED_M = 1e-6  # Error of loops that are closed [m or rad]
LEAST_WAY = 0.25  # Share of a way from which ranges of coupled joints stop it
SLACK = 0.02  # Of a range, by which they may leave theirs


def _actuated(model: MjModel) -> set[int]:
    """Return the joints that actuators move, directly or by a tendon."""
    joints: set[int] = set()
    for kind, (target, _) in zip(
        model.actuator_trntype, model.actuator_trnid, strict=True
    ):
        if kind == mjtTrn.mjTRN_JOINT:
            joints.add(int(target))
        elif kind == mjtTrn.mjTRN_TENDON:
            start = model.tendon_adr[target]
            wrapped = model.wrap_objid[start : start + model.tendon_num[target]]
            joints.update(wrapped.tolist())
    return joints


class Motion:
    """Motion of a gripper: its joints move as the file couples them, in chains or closed loops."""

    def __init__(self, drawn: MjData, joints: Ids) -> None:
        model = copy.copy(drawn.model)
        model.opt.jacobian = mjtJacobian.mjJAC_DENSE
        for bit in (mjtDisableBit.mjDSBL_CONTACT, mjtDisableBit.mjDSBL_LIMIT):
            model.opt.disableflags |= bit
        self.data = MjData(model)
        self._model = model
        self._drawn = drawn.qpos.copy()
        self.joints = [j for j in joints if model.jnt_type[j] in MOVABLE]
        self._followers = self._dependent()
        free = [j for j in self.joints if j not in self._followers]
        driven = [j for j in free if j in _actuated(model)] or free
        self.drivers = [j for j in driven if model.jnt_limited[j]]

    def _dependent(self) -> Ids:
        """Return joints that all others determine, those that can drive last."""
        model = self._model
        is_pair = model.eq_type == mjtEq.mjEQ_JOINT
        mimics = model.eq_obj1id[is_pair]
        leaders = model.eq_obj2id[is_pair]
        actuated = _actuated(model)

        def aptness(joint: int) -> tuple[bool | int, ...]:
            return (
                model.jnt_limited[joint],
                joint not in mimics,
                joint in leaders,
                joint in actuated,
                -joint,
            )

        jacobian, _ = self._loops()
        followers: Ids = []
        for joint in sorted(self.joints, key=aptness):
            columns = model.jnt_dofadr[[*followers, joint]]
            if matrix_rank(np.pad(jacobian[:, columns], 1)) > len(followers):
                followers.append(joint)
        return followers

    def _loops(self) -> tuple[Floats, Floats]:
        """Return Jacobian (E, V) and errors (E,) of the file's equalities."""
        data = self.data
        mj_fwdPosition(self._model, data)
        jacobian = data.efc_J.reshape(-1, self._model.nv)
        return jacobian[: data.ne], data.efc_pos[: data.ne]

    def pose(self, ends: Mapping[int, float]) -> Floats | None:
        """Return qpos where joints are at ends, or as near as the others' ranges allow.

        Ranges that stop them at once are those of a file that does not mean them, as of mimic
        joints that turn the other way. None where the equalities hold nowhere on the way.
        """
        moved = self._model.jnt_qposadr[[*ends]]
        start = self._drawn[moved]
        self.data.qpos = self._drawn
        inside = closed = None
        for share in np.linspace(0, 1, STEPS + 1):
            self.data.qpos[moved] = start + share * (np.array([*ends.values()]) - start)
            if self._close():
                closed = self.data.qpos.copy()
                if self._is_inside():
                    inside = closed
                elif share < LEAST_WAY:
                    inside = None
        return closed if inside is None else inside

    def _close(self) -> bool:
        """Move followers until the file's equalities hold; return whether they do."""
        columns = self._model.jnt_dofadr[self._followers]
        address = self._model.jnt_qposadr[self._followers]
        for _ in range(ITERATIONS):
            jacobian, errors = self._loops()
            jacobian = jacobian[:, columns]
            is_own = jacobian.any(axis=1)
            if np.abs(errors[is_own]).max(initial=0.0) < CLOSED_M:
                return True
            self.data.qpos[address] -= np.linalg.pinv(jacobian[is_own]) @ errors[is_own]
        return False

    def _is_inside(self) -> bool:
        """Return whether all followers are in their ranges."""
        low, high = self._model.jnt_range[self._followers].T
        slack = SLACK * (high - low) + SAME_M
        values = self.data.qpos[self._model.jnt_qposadr[self._followers]]
        is_inside = (values > low - slack) & (values < high + slack)
        is_free = self._model.jnt_limited[self._followers] == 0
        return bool((is_inside | is_free).all())

    def at(self, qpos: Floats) -> MjData:
        """Return the model at joint positions."""
        self.data.qpos = qpos
        mj_kinematics(self._model, self.data)
        return self.data

    def ends(self, drivers: Ids) -> list[Floats]:
        """Return qpos at all combinations of the ends of drivers that the gripper reaches."""
        poses = []
        for ends in product(*self._model.jnt_range[drivers]):
            pose = self.pose(dict(zip(drivers, ends, strict=True)))
            if pose is not None:
                poses.append(pose)
        return poses

    def shifts(self, groups: Sequence[Ids]) -> Floats:
        """Return how far each driver moves groups of geoms, (drivers, groups, 3) [m]."""
        shifts = np.zeros((len(self.drivers), len(groups), 3))
        for k, driver in enumerate(self.drivers):
            for qpos, sign in zip(self.ends([driver]), (-1, 1), strict=False):
                places = self.at(qpos).geom_xpos
                middles = [places[geoms].mean(axis=0) for geoms in groups]
                shifts[k] += sign * np.array(middles)
        return shifts

    def root(self, geoms: Ids) -> int:
        """Return the first body on the way from the hand to geoms that the gripper moves."""
        model = self._model
        moving = model.jnt_bodyid[self.joints]
        body = int(model.geom_bodyid[geoms[0]])
        first = body
        while body:
            if body in moving:
                first = body
            body = int(model.body_parentid[body])
        return first

    def side(self, fingers: Sequence[Ids], across: Floats) -> float:
        """Return how far the way of a finger begins beyond that of another [m], 0 if nowhere."""
        model = self._model
        data = self.at(self._drawn)
        begins = []
        for geoms in fingers:
            first = self.root(geoms)
            parent = model.body_parentid[first]
            turn = data.xmat[parent].reshape(3, 3)
            begins.append(data.xpos[parent] + turn @ model.body_pos[first])
        between = (begins[0] - begins[1]) @ across
        if abs(between) > SAME_M:
            return float(between)
        return 0.0

    def drivers_of(self, groups: Sequence[Ids]) -> Ids:
        """Return the joints that drive groups of geoms."""
        moved = norm(self.shifts(groups), axis=2) > SAME_M
        return [self.drivers[k] for k in np.flatnonzero(moved.any(axis=1))]

    def named(self, qpos: Floats, others: Sequence[Floats]) -> dict[str, float]:
        """Return the values of joints that have names and differ in other poses."""
        values = {}
        for joint in self.joints:
            address = self._model.jnt_qposadr[joint]
            name = self._model.joint(joint).name
            if name and np.ptp([pose[address] for pose in others]) > CLOSED_M:
                values[name] = float(qpos[address].round(5)) + 0.0
        return values


class Opening(NamedTuple):
    """Two fingers that are open."""

    gap_m: float  # Between the tips of the surfaces that meet
    tip: Floats  # Middle between the ends of those, world (3,) [m]
    retreat_m: float  # How far the ends lie behind those of closed fingers
    joints: dict[str, float]  # Values of the gripper's joints by name
    bodies: tuple[int, int]  # Those that hold most of the tips


class Surfaces(NamedTuple):
    """Points on the surfaces of two fingers."""

    points: Floats  # In any direction, across the hand and out of it, (P, 3) [m]
    is_first: Mask  # Which are the first finger's, (P,)
    bodies: Integers  # Ids of their bodies, (P,)

    @classmethod
    def of(cls, data: MjData, fingers: Sequence[Ids], frame: Floats) -> "Surfaces":
        """Return those of fingers' geoms, in a frame (3, 3) whose columns are directions."""
        first, second = fingers
        geoms = [*first, *second]
        points = [surface_points(data, geom) @ frame for geom in geoms]
        owners = np.repeat(geoms, [len(part) for part in points])
        bodies = data.model.geom_bodyid[owners]
        return cls(np.concatenate(points), np.isin(owners, first), bodies)

    def end(self, mask: Mask) -> float:
        """Return how far the finger of some points that ends first reaches [m]."""
        along = self.points[:, 2]
        ends = [along[mask & side].max() for side in (self.is_first, ~self.is_first)]
        return float(min(ends))

    def tips(self, mask: Mask | bool = True) -> Mask:
        """Return which of some points are those of the tips, (P,)."""
        mask = mask & (self.is_first | True)
        along = self.points[:, 2]
        tip_m = min(TIP_M, TIP_SHARE * np.ptp(along[mask]))
        return mask & (along > self.end(mask) - tip_m)

    def gap(self, mask: Mask) -> tuple[float, float, bool]:
        """Return gap and middle of some points across the hand [m]; is the first finger higher?"""
        across = self.points[:, 1]
        first = across[mask & self.is_first]
        second = across[mask & ~self.is_first]
        above = first.min() - second.max()
        below = second.min() - first.max()
        if above > below:
            return above, (first.min() + second.max()) / 2, True
        return below, (second.min() + first.max()) / 2, False

    def body(self, mask: Mask) -> int:
        """Return the body that has most of some points."""
        return int(np.bincount(self.bodies[mask]).argmax())

    def meeting(self) -> Mask:
        """Return which points of closed fingers are the tips of the surfaces that meet, (P,).

        What fingers carry outside, such as a camera or a screw, may reach farther, and meets
        nothing.
        """
        tips = self.tips()
        gap, middle, is_higher = self.gap(tips)
        if gap < -LEAST_M:  # they pass through each other
            return tips
        beyond = self.points[:, 1] - middle
        beyond[self.is_first != is_higher] *= -1
        return self.tips(beyond <= max(gap, 0.0) / 2 + MEET_M)


def widest_opening(
    motion: Motion, drivers: Ids, fingers: Sequence[Ids], frame: Floats
) -> Opening | None:
    """Return the widest opening of two fingers at the ends of the joints that drive them.

    ``fingers`` are their geoms. The columns of ``frame`` (3, 3), world, are any direction, that
    across the hand in which the fingers open, and that out of the hand. None if the gripper
    reaches no end. The gap is negative where the tips overlap. Where fingers could pass through
    each other, the one counts in which each is on the side on which its way begins.
    """
    poses = motion.ends(drivers)
    if not poses:
        return None
    side = motion.side(fingers, frame[:, 1])
    surfaces = []
    is_swapped = []
    for qpos in poses:
        drawn = Surfaces.of(motion.at(qpos), fingers, frame)
        across = drawn.points[:, 1]
        apart = across[drawn.is_first].mean() - across[~drawn.is_first].mean()
        is_swapped.append(apart * side < 0)
        surfaces.append(drawn)
    gaps = np.array([drawn.gap(drawn.tips())[0] for drawn in surfaces])
    closed = surfaces[np.lexsort((gaps, is_swapped, gaps < -LEAST_M))[0]]
    tips = closed.meeting()
    gaps = np.array([drawn.gap(tips)[0] for drawn in surfaces])
    best = np.lexsort((-(gaps / SAME_M).round(), is_swapped))[0]
    _, middle, _ = surfaces[best].gap(tips)
    points = surfaces[best].points[tips]
    end = surfaces[best].end(tips)
    aside = (points[:, 0].min() + points[:, 0].max()) / 2
    return Opening(
        float(gaps[best]),
        frame @ np.array([aside, middle, end]),
        closed.end(tips) - end,
        motion.named(poses[best], poses),
        (closed.body(tips & closed.is_first), closed.body(tips & ~closed.is_first)),
    )


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
    for name in robot.fingers:
        geom = mj_name2id(model, mjtObj.mjOBJ_GEOM, name)
        body = mj_name2id(model, mjtObj.mjOBJ_BODY, name)
        if body >= 0:
            fingers.append(solid_geoms(model, [body]))
        else:
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
    surfaces = Surfaces.of(data, fingers, frame)
    drawn, *_ = surfaces.gap(surfaces.tips())
    found = f"{names} are drawn {100 * drawn:.1f} cm apart"
    motion = Motion(
        data, [j for j in range(model.njnt) if model.joint(j).name not in robot.joints]
    )
    drivers = motion.drivers_of(fingers)
    best = None
    if 0 < len(drivers) <= MOST_DRIVERS:
        best = widest_opening(motion, drivers, fingers, frame)
    if best is None or drawn >= min(LEAST_SHARE * best.gap_m, best.gap_m - SAME_M):
        remedy = "Open them in the file, or with held_joints."
        return Check("fingers", drawn >= LEAST_M, found, remedy)
    held = ", ".join(f"{name} = {value:g}" for name, value in best.joints.items())
    return Check(
        "fingers",
        False,
        f"{found}, and {100 * best.gap_m:.1f} cm at the other end",
        f"Draw them open: held_joints = {{ {held} }}.",
    )
