"""Guide of lifting: a path to a grasp that touches nothing else, by trying several of them."""

from collections.abc import Iterator, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from knowarm.arrays import Floats, Indices, Mask
from knowarm.world.scene.scene import build_scene
from knowarm.world.tasks.skills.guides import Guide, JointPath, Sight
from knowarm.world.tasks.skills.ik import (
    FEW_POSES,
    REACHED_DEG,
    REACHED_M,
    InverseKinematics,
)
from knowarm.world.tasks.skills.lift.model import LiftScene
from knowarm.world.tasks.skills.lift.simulator import LiftSimulator
from knowarm.world.tasks.state import places_of_all

BACK_M = (0.10, 0.075, 0.05, 0.035, 0.02, 0.01)  # Distances of the straight approach
# Heights above its first pose, of which some may be left out
OVER_M = (0.15, 0.10, 0.05)
RISE_M = (0.03, 0.06, 0.10, 0.14)  # Heights of the path upwards
CLOSED = (0.0, 0.35)  # Shares of their way that fingers are closed before the grasp
FAR_M = 100.0  # Where nothing is touched
UP = np.array([0.0, 0.0, 1.0])
UNREACHED = 1000.0  # Cost of a pose that the arm does not reach [steps]
CLEARANCE_M = 0.006  # Least distance from other objects
GRIP_STEPS = 3  # Steps until closing fingers have gripped
SETTLE_STEPS = 2  # Steps until the arm has followed its joint targets

# Largest errors at which points are passed [largest steps]
TO_APPROACH = 1.0
ON_APPROACH = 0.5
NEAR_GRASP = 0.2
NEAR_POSES = 5  # Poses of the approach at which the object may be between the fingers
MOST_STEPS = 4.0  # Between two poses; more where the arm would turn over


class Turn(NamedTuple):
    """How a grasp differs from the one that an object's description gives."""

    about_vertical_deg: float
    about_fingers_deg: float  # about the axis along which the fingers close
    is_flipped: bool  # half a turn about the approach, which swaps the fingers

    @property
    def detour(self) -> float:
        """Return how much longer another path may be before this turn is preferred [steps]."""
        return abs(self.about_fingers_deg) / 5 + abs(self.about_vertical_deg) / 4

    def of(self, matrix: Floats) -> Floats:
        """Turn grasp frames, row-major rotations (n, 9)."""
        vertical = rotation(2, self.about_vertical_deg)
        tilt = rotation(1, self.about_fingers_deg)
        flip = rotation(2, 180.0 * self.is_flipped)
        turned = vertical @ matrix.reshape(-1, 3, 3) @ tilt @ flip
        return turned.reshape(-1, 9)


def _turns(about_vertical_deg: float, *about_fingers_deg: float) -> list[Turn]:
    """List turns, each as it is and flipped."""
    turns = []
    for tilt in about_fingers_deg:
        turns.append(Turn(about_vertical_deg, tilt, False))
        turns.append(Turn(about_vertical_deg, tilt, True))
    return turns


TRIED = (
    _turns(0.0, 0.0, 20.0, -20.0),
    _turns(0.0, 40.0, -40.0, 60.0, -60.0, 80.0, -80.0)
    + _turns(25.0, 0.0, 40.0, -40.0, 80.0, -80.0)
    + _turns(-25.0, 0.0, 40.0, -40.0, 80.0, -80.0),
)
"""Turns of the grasp; the second ones where no path to one of the first is free."""


class Candidate(NamedTuple):
    """A path to a grasp of k of the episodes, without its beginning."""

    ids: Indices
    """Numbers of the episodes, (k,)."""
    poses: Floats
    """Joint angles from above to the grasp, (k, P, A) [rad]."""
    closed: float
    """Share of their way that the fingers are closed on it."""
    is_reached: Mask
    """Whether the arm reaches all of it, (k,)."""


class Leg(NamedTuple):
    """A piece of the paths of n episodes, on which the fingers do not move."""

    points: Floats
    """Joint angles, (n, W, A) [rad]."""
    fingers: Floats
    """How far each finger is closed, (n,) [m]."""
    tolerance: Floats
    """Largest error of a joint at which each point is passed [largest steps], (W,)."""
    pause: int
    """Steps at the last point."""


def joined(legs: Sequence[Leg], largest_step: float) -> JointPath:
    """Return the path along legs one after the other."""
    points = []
    pauses = []
    for leg in legs:
        count = leg.points.shape[1]
        fingers = np.repeat(leg.fingers[:, None, None], count, axis=1)
        points.append(np.concatenate([leg.points, fingers], axis=2))
        pauses.append(np.pad([leg.pause], (count - 1, 0)))
    tolerance = np.concatenate([leg.tolerance for leg in legs])
    return JointPath(
        np.concatenate(points, axis=1), largest_step, tolerance, np.concatenate(pauses)
    )


class LiftGuide(Guide):
    """Moves around other objects to a grasp, closes the fingers, and lifts.

    Of several grasps of the object, which differ by a tilt about the fingers' axis, a turn about
    the vertical and half a turn of the gripper, it takes the one with the shortest path on which
    the arm touches nothing. Where there is none, it takes the shortest path.

    Attributes:
        is_free: which episodes of the last `path` have one on which the arm touches nothing, (n,).
    """

    moves_fingers = True
    is_free: Mask

    def __init__(self, scene: LiftScene, *args: Any, **options: Any) -> None:
        super().__init__(scene, *args, **options)
        self._lifting = scene
        self._closed_m = float(scene.joint_upper[-1])
        self._arm = build_scene(scene.robot, scene.targets[:1])
        self._solver = InverseKinematics(self._arm, starts=4, seed=self._seed)
        self._follower = InverseKinematics(self._arm, starts=1, seed=self._seed)

    def path(self, sight: Sight) -> JointPath:
        """Solve the path of every episode."""
        surroundings = Surroundings(self._lifting, sight)
        n = len(sight.position)
        start = sight.joints[:, :-1]
        closed = np.zeros(n)
        self.is_free = np.zeros(n, bool)
        poses: Floats | None = None
        for candidate in self._candidates(sight):
            if poses is None:
                poses = candidate.poses.copy()
            ids = candidate.ids
            path = self._path_through(start[ids], candidate.poses)
            is_free = surroundings.are_free(
                ids, path[:, ::-1], candidate.closed, candidate.is_reached
            )
            chosen = ids[is_free]
            poses[chosen] = candidate.poses[is_free]
            closed[chosen] = candidate.closed
            self.is_free[chosen] = True
        assert poses is not None
        path = self._path_through(start, poses)
        grasp = path[:, -1]
        fingers = closed * self._closed_m
        tolerance = np.full(path.shape[1], TO_APPROACH)
        tolerance[-poses.shape[1] :] = ON_APPROACH
        tolerance[-NEAR_POSES:] = NEAR_GRASP
        legs = [
            Leg(path, fingers, tolerance, SETTLE_STEPS),
            self._standing(grasp, self._closed_m, GRIP_STEPS),
            *self._after_grip(sight, path, surroundings),
        ]
        return joined(legs, self._largest)

    def _after_grip(
        self, sight: Sight, path: Floats, surroundings: "Surroundings"
    ) -> list[Leg]:
        """Return the legs after the fingers have closed at the end of a path (n, W, A)."""
        grasp = path[:, -1]
        position, matrix = self._follower.pose(grasp)
        shifts = np.outer(RISE_M, UP)
        rise = self._follower.solve_path(position, matrix, grasp, shifts)
        return [self._moving(rise, self._closed_m)]

    def _standing(self, joints: Floats, fingers: float, pause: int) -> Leg:
        """Return the leg of an arm that stands at joint angles (n, A) while fingers move."""
        tolerance = np.full(1, NEAR_GRASP)
        return Leg(joints[:, None], np.full(len(joints), fingers), tolerance, pause)

    def _moving(self, points: Floats, fingers: float) -> Leg:
        """Return the leg of an arm that passes points (n, W, A)."""
        tolerance = np.full(points.shape[1], TO_APPROACH)
        return Leg(points, np.full(len(points), fingers), tolerance, 0)

    def _candidates(self, sight: Sight) -> Iterator[Candidate]:
        """Yield paths for the episodes without a free one yet, first one for each."""
        for turns in TRIED:
            ids = np.flatnonzero(~self.is_free)
            if not len(ids):
                return
            position = np.tile(sight.position[ids], (len(turns), 1, 1))
            matrix = np.stack([turn.of(sight.matrix[ids]) for turn in turns])
            joints, steps = self._solve_near(position, matrix, sight.joints[ids, :-1])
            detours = np.array([[turn.detour] for turn in turns])
            cost = np.minimum(steps + detours, UNREACHED)
            order = np.argsort(cost, axis=0, kind="stable")
            is_reached = np.sort(cost, axis=0) < UNREACHED
            for ranks, columns in tries_at_once(is_reached, self.is_free, ids):
                grasp = (order[ranks][:, columns], columns)
                solved = self._approach(position[grasp], matrix[grasp], joints[grasp])
                for rank, poses in enumerate(solved, ranks.start):
                    yield from self._lowered(
                        ids[columns], poses, is_reached[rank, columns]
                    )

    def _solve_near(
        self, position: Floats, matrix: Floats, start: Floats
    ) -> tuple[Floats, Floats]:
        """Solve for T poses in each of k episodes at once, which takes little longer than for one.

        Positions (T, k, 3) [m] and row-major rotations (T, k, 9) are those of the gripper.

        Returns:
            Joint angles (T, k, A) [rad] near the start (k, A), and steps to there, or
            `UNREACHED`, (T, k).
        """
        solution = self._solver.solve(position, matrix, start, attempts=1)
        steps = np.abs(solution.joints - start).max(axis=2) / self._largest
        is_reached = solution.within(REACHED_M, REACHED_DEG)
        return solution.joints, np.where(is_reached, steps, UNREACHED)

    def _approach(self, position: Floats, matrix: Floats, joints: Floats) -> Floats:
        """Return joint angles from above to grasps at joint angles (R, k, A), (R, k, P, A)."""
        back = -matrix.reshape(*joints.shape[:2], 3, 3)[..., 2]
        shifts = [distance * back for distance in reversed(BACK_M)]
        shifts += [BACK_M[0] * back + height * UP for height in reversed(OVER_M)]
        approach = self._follower.solve_path(position, matrix, joints, np.stack(shifts))
        return np.concatenate([approach[:, :, ::-1], joints[:, :, None]], axis=2)

    def _lowered(
        self, ids: Indices, poses: Floats, is_reached: Mask
    ) -> Iterator[Candidate]:
        """Yield paths along poses (k, P, A) for those of k episodes that need one."""
        straight = poses[:, len(OVER_M) :]
        jumps = np.abs(np.diff(straight, axis=1)).max(axis=(1, 2))
        is_reached &= jumps <= MOST_STEPS * self._largest  # Else it turns over
        for closed, left_out in product(CLOSED, reversed(range(len(OVER_M) + 1))):
            is_open = ~self.is_free[ids]
            lowered = poses[is_open]
            lowered[:, :left_out] = lowered[:, left_out : left_out + 1]
            if len(lowered):
                yield Candidate(ids[is_open], lowered, closed, is_reached[is_open])

    def _path_through(self, start: Floats, poses: Floats) -> Floats:
        """Return joint angles from the start (k, A) to the poses and along them, (k, W, A).

        Each moves by at most a largest step from point to point. Shorter paths begin with copies of
        the start, so that none depends on the others.
        """
        change = poses[:, 0] - start
        counts = np.ceil(np.abs(change).max(axis=1) / self._largest).clip(min=1)
        copies = counts.max() - counts
        steps = (np.arange(counts.max()) - copies[:, None]).clip(min=0)
        share = steps / counts[:, None]
        before = start[:, None] + share[..., None] * change[:, None]
        return np.concatenate([before, poses], axis=1)


def tries_at_once(
    can_be_free: Mask, is_free: Mask, ids: Indices
) -> Iterator[tuple[slice, Indices]]:
    """Yield which of T tries to solve at once, and for which of k episodes: those without a path.

    The first alone, since mostly its path is free; then as many as take little longer than one.

    Args:
        can_be_free: whether a try can give a free path, (T, k); after one that cannot, none can.
        is_free: which episodes have such a path, (n,), by what the caller has tried.
        ids: numbers of the k episodes, (k,).
    """
    first = 0
    last = 1
    columns = np.arange(len(ids))
    while first < last:
        yield slice(first, last), columns
        columns = np.flatnonzero(~is_free[ids])
        hopeful = can_be_free[:, columns].any(axis=1).sum()
        first = last
        last = min(first + 1 + FEW_POSES // (1 + len(columns)), hopeful)


class Surroundings:
    """Tells where the arm of n episodes touches something, by the shapes of a scene.

    Args:
        scene: robot and objects.
        sight: which objects stand where; one that is not in it is not there.
    """

    def __init__(self, scene: LiftScene, sight: Sight) -> None:
        n = len(sight.objects)
        threads = 1 if n <= FEW_POSES else 0
        simulator = LiftSimulator(scene, n, threads)
        margin = simulator.batch.expand("geom_margin").reshape(n, -1)
        is_object = scene.geom_target >= 0
        margin[is_object & (scene.geom_target != sight.objects[:, :1])] = CLEARANCE_M
        contacts = simulator.batch.bind("ncon").reshape(n)
        places, visible = places_of_all(sight.objects, sight.places, len(scene.targets))
        home = np.tile(scene.home, (n, 1))
        simulator.reset(np.arange(n), home, places, None, visible)
        simulator.set_joints(home)
        self._simulator = simulator
        self._contacts = contacts
        # Of the objects with what they stand on
        self._others = contacts.copy()
        self._closed_m = scene.joint_upper[-1]
        self._home = scene.home[:-1]
        self._target = sight.objects[:, 0]
        self._held: tuple[Floats, Floats] | None = None  # Its pose in the gripper

    def are_free(
        self, ids: Indices, path: Floats, closed: float, can_be: Mask | bool = True
    ) -> Mask:
        """Return in which episodes (k,) nothing is touched on a path (k, W, A) [rad], (k,).

        ``closed`` is the share of their way that the fingers are closed. Paths that ``can_be`` free
        are looked at.
        """
        is_free = np.full(len(ids), can_be)
        for joints in path.transpose(1, 0, 2):
            left = np.flatnonzero(is_free)
            if not len(left):
                break
            self._pose(ids[left], joints[left], closed)
            touches = self._contacts[ids[left]] > self._others[ids[left]]
            is_free[left] = ~touches
        return is_free

    def hold(self, grasp: Floats) -> None:
        """Let the gripper hold the object that is meant, from joint angles (n, A) on."""
        simulator = self._simulator
        ids = np.arange(len(grasp))
        self._pose(ids, grasp, 0.0)
        gripper = simulator.tcp_matrix.reshape(-1, 3, 3)
        place, turn = simulator.pose(self._target)
        back = gripper.transpose(0, 2, 1)
        offset = (back @ (place - simulator.tcp_position)[..., None])[..., 0]
        held = (offset, back @ turn)
        # Without what the object stands on
        simulator.set_pose(ids, self._target, place + FAR_M, turn)
        self._pose(ids, np.tile(self._home, (len(ids), 1)), 0.0)
        self._others = self._contacts.copy()
        self._held = held

    def _pose(self, ids: Indices, joints: Floats, closed: float) -> None:
        """Put the arms of episodes (k,) at joint angles (k, A), with what they hold."""
        simulator = self._simulator
        fingers = np.full(len(ids), closed * self._closed_m)
        pose = np.column_stack([joints, fingers])
        simulator.set_joints(pose, ids)
        if self._held is None:
            return
        offset, turn = (part[ids] for part in self._held)
        gripper = simulator.tcp_matrix[ids].reshape(-1, 3, 3)
        place = simulator.tcp_position[ids] + (gripper @ offset[..., None])[..., 0]
        simulator.set_pose(ids, self._target[ids], place, gripper @ turn)
        simulator.set_joints(pose, ids)


def rotation(axis: int, angle_deg: float) -> Floats:
    """Return the rotation about the y (1) or z (2) axis, (3, 3)."""
    angle = np.radians(angle_deg)
    cosine = np.cos(angle)
    sine = np.sin(angle)
    if axis == 1:
        return np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])
    return np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
