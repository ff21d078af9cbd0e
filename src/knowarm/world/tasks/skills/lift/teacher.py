"""Teacher of the lifting task: approach, close the fingers, lift, by inverse kinematics."""

from itertools import pairwise

import numpy as np

from knowarm.arrays import Floats, Integers
from knowarm.world.tasks.sampling import Episodes
from knowarm.world.tasks.skills.lift.model import SQUEEZE_M
from knowarm.world.tasks.skills.lift.simulator import LiftSimulator
from knowarm.world.tasks.skills.teacher import PRACTICE_NOISE, GoalTable, Teacher
from knowarm.world.tasks.state import EpisodeState

APPROACH_M = (0.07, 0.035)  # Distances of the poses of the approach from the grasp frame
OVER_M = 0.05  # Height of the first pose above the start of the approach
RISE_M = (0.04, 0.08, 0.12)  # Heights of the poses of the way upwards
POINTS = 6  # Points between two poses
AHEAD = 4  # Points from the one that is passed to the one that is aimed at
PASSED = (1.0, 0.6)
"""Largest error of a joint at which a point is passed, first and last one [largest steps]."""
LOST = 4.0  # Error from which the way starts again at its first point [largest steps]
CLOSE_M, CLOSE_DEG = 0.025, 12.0
"""Largest distance and angle to the grasp frame at which fingers close; an arm of small steps has
to come as much nearer as its largest step is smaller than ``CLOSE_RAD``."""

CLOSE_RAD = 0.05
MET_M = 0.001  # Distance of the fingers from each other at which they have met
NOISE_AT_GRASP = 0.5  # `PRACTICE_NOISE` at the end of the approach
ON_APPROACH = 0.67  # Share of practice starts on the approach


class LiftTeacher(Teacher):
    """Approaches the object of every running episode, closes the fingers and lifts.

    What it does depends on the state alone: with open fingers it follows the poses of the approach
    from the furthest that is passed, at the last one it closes them, and as soon as both touch the
    object it follows the poses of the way upwards. Fingers that close on nothing open again.
    """

    def __init__(self, state: EpisodeState[LiftSimulator]) -> None:
        scene = state.scene
        super().__init__(state)
        self._simulator = state.simulator
        self._near = min(1.0, float(self._largest) / CLOSE_RAD)
        back = -scene.grasp_matrix[:, :, 2]
        up = np.tile([0.0, 0.0, 1.0], (len(back), 1))
        self._approach = [self.goals]
        for shift in (*(d * back for d in sorted(APPROACH_M)), APPROACH_M[0] * back + OVER_M * up):
            self._approach.insert(0, self._approach[0].shifted(shift))
        self._rise = [self.goals]
        for height in RISE_M:
            self._rise.append(self._rise[-1].shifted(height * up))

    def error(self) -> Floats:
        """Return the way from joint targets to the next pose in largest steps, (n, J)."""
        state, simulator, target = self._state, self._simulator, self._state.target
        joints, fingers = state.joint_targets[:, :-1], state.joint_targets[:, -1]
        closed_m = state.scene.joint_upper[-1]
        closed = fingers > closed_m / 2
        held = closed & simulator.touched(target)
        met = simulator.joint_positions[:, -1] > closed_m - SQUEEZE_M - MET_M
        closing = closed & ~held & ~met
        places = np.where(closed[:, None], state.positions[:, 0], simulator.place(target))
        approach = _points(self._approach, target, places)
        error = np.abs(approach - joints).max(axis=2) / self._largest  # (W, n)
        following = _next_point(error)
        rise = _points(self._rise, target, places)
        lowest = np.abs(rise - joints).max(axis=2).argmin(axis=0)
        above = np.minimum(lowest + AHEAD, len(rise) - 1)
        rows = np.arange(len(joints))
        pose = np.where(held[:, None], rise[above, rows], approach[following, rows])
        pose = np.where(closing[:, None], joints, pose)
        at_grasp = (state.distance < self._near * CLOSE_M) & (state.angle < self._near * CLOSE_DEG)
        close = held | closing | (~closed & at_grasp)
        way = np.column_stack([pose - joints, np.where(close, closed_m, 0.0) - fingers])
        return np.asarray(way / self._largest)

    def practice_point(
        self, episodes: Episodes, start: Floats, share: Floats, noise: Floats, choice: Floats
    ) -> Floats:
        """Return joint angles on the approach, or before it, (k, J) [rad]."""
        way = _points(self._approach, episodes.target, episodes.position)
        at = (share[:, 0] * len(way)).astype(np.int64)
        spread = np.interp(at, (0, len(way) - 1), (PRACTICE_NOISE, NOISE_AT_GRASP))[:, None]
        reached = share * np.abs(way[0] - start).max(axis=1, keepdims=True)
        before = start + (way[0] - start).clip(-reached, reached) + PRACTICE_NOISE * noise
        return np.where(choice < ON_APPROACH, way[at, np.arange(len(at))] + spread * noise, before)


def _points(tables: list[GoalTable], objects: Integers, places: Floats) -> Floats:
    """Return ``POINTS`` points from each pose to the next, and the last pose, (W, n, J) [rad]."""
    poses = [table(objects, places) for table in tables]
    shares = np.linspace(0.0, 1.0, POINTS, endpoint=False)[:, None, None]
    return np.concatenate(
        [*((1 - shares) * a + shares * b for a, b in pairwise(poses)), [poses[-1]]]
    )


def _next_point(error: Floats) -> Integers:
    """Return the point of the approach to aim at, (n,), from the error at each, (W, n)."""
    last, nearest = len(error) - 1, error.argmin(axis=0)
    passed = error < np.linspace(*PASSED, last + 1)[:, None]
    furthest = last - passed[::-1].argmax(axis=0)
    point = np.where(passed.any(axis=0), np.minimum(furthest + AHEAD, last), nearest)
    return np.where(error.min(axis=0) > LOST, 0, point)
