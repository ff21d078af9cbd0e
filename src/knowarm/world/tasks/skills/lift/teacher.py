"""Teacher of the lifting task: approach, close the fingers, lift, by inverse kinematics."""

from collections.abc import Sequence
from itertools import accumulate

import numpy as np

from knowarm.arrays import Floats, Integers, Mask
from knowarm.world.tasks.reward import is_success
from knowarm.world.tasks.sampling import Episodes
from knowarm.world.tasks.skills.lift.model import SQUEEZE_M
from knowarm.world.tasks.skills.lift.simulator import LiftSimulator
from knowarm.world.tasks.skills.teacher import (
    PRACTICE_NOISE,
    GoalTable,
    Teacher,
    interpolate,
    towards,
)
from knowarm.world.tasks.state import EpisodeState

POINTS = 6  # Points between two poses
AHEAD = 4  # Points from the one that is passed to the one that is aimed at
PASSED = (1.0, 0.6)
"""Largest error of a joint at which the first and the last point are passed [largest steps]."""
LOST = 4.0  # Error at every point from which the path starts again at its first [largest steps]
CLOSE_DEG = 12.0  # Largest angle to the grasp frame at which fingers close
CLOSE_RAD = 0.05
MET_M = 0.001  # Distance of the fingers from each other at which they have met
NOISE_AT_GRASP = 0.5  # `PRACTICE_NOISE` at the end of the approach
ON_APPROACH = 0.67  # Share of practice starts on the approach


class LiftTeacher(Teacher):
    """Approaches the object of every running episode, closes the fingers and lifts.

    What it does depends on the state alone: with open fingers it follows the poses of the approach
    from the furthest that is passed, at the last one it closes them, and as soon as both touch the
    object it follows the poses of the path upwards. Fingers that close on nothing open again.

    An arm of small steps has to come as much nearer before it closes them as its largest step is
    smaller than ``CLOSE_RAD``.
    """

    approach_m: tuple[float, ...] = (0.035, 0.07)
    """Distances of the poses of the approach from the grasp frame."""
    over_m = 0.05
    """Height of the first pose above the start of the approach."""
    rise_m: tuple[float, ...] = (0.04, 0.08, 0.12)
    """Heights of the poses of the path upwards."""
    close_m = 0.025
    """Largest distance to the grasp frame at which fingers close."""

    def __init__(self, state: EpisodeState[LiftSimulator]) -> None:
        super().__init__(state)
        self._simulator = state.simulator
        nearness = min(1.0, float(self._largest) / CLOSE_RAD)
        self._close_m = nearness * self.close_m
        self._close_deg = nearness * CLOSE_DEG
        self._opened_m = 0.0  # Where fingers go that open
        back = -state.scene.grasp_matrix[:, :, 2]
        up = np.tile([0.0, 0.0, 1.0], (len(back), 1))
        shifts = [distance * back for distance in self.approach_m]
        shifts.append(self.approach_m[-1] * back + self.over_m * up)
        self._approach = self._moved(shifts)
        self._approach.reverse()
        self._rise = self._moved([height * up for height in self.rise_m])

    def _moved(self, shifts: Sequence[Floats]) -> list[GoalTable]:
        """Return the table of the grasp frames and shifted ones, each solved from the last."""
        return list(accumulate(shifts, GoalTable.shifted, initial=self.goals))

    def error(self) -> Floats:
        """Return the way from joint targets to the next pose in largest steps, (n, J)."""
        state = self._state
        target = state.target
        joints = state.joint_targets[:, :-1]
        fingers = state.joint_targets[:, -1]
        closed_m = state.scene.joint_upper[-1]
        is_closed = fingers > closed_m / 2
        is_held = is_closed & self._simulator.touched(target)
        # Fingers that meet hold nothing, and open again.
        met_m = closed_m - SQUEEZE_M - MET_M
        have_met = self._simulator.joint_positions[:, -1] > met_m
        is_closing = is_closed & ~is_held & ~have_met
        # Open fingers follow an object that was pushed; closed ones keep to where it stood.
        place_now = self._simulator.place(target)
        places = np.where(is_closed[:, None], state.positions[:, 0], place_now)
        approach = path_of(self._approach, target, places)
        error = _largest_errors(approach, joints) / self._largest
        aimed_at = _next_point(error)
        arm_goal = approach[aimed_at, np.arange(len(joints))]
        held_goal, lets_go = self._with_object(joints)
        arm_goal = np.where(is_held[:, None], held_goal, arm_goal)
        left_goal, is_put_down = self._after_release(joints)
        has_left = is_put_down & ~is_closed
        arm_goal = np.where(has_left[:, None], left_goal, arm_goal)
        # The arm waits while the fingers close.
        arm_goal = np.where(is_closing[:, None], joints, arm_goal)
        is_at_grasp = is_success(
            state.distance, state.angle, self._close_m, self._close_deg
        )
        grips = ~is_closed & ~has_left & is_at_grasp
        closes = (is_held & ~lets_go) | is_closing | grips
        finger_goals = np.where(closes, closed_m, self._opened_m)
        goals = np.column_stack([arm_goal, finger_goals])
        return (goals - state.joint_targets) / self._largest

    def _with_object(self, joints: Floats) -> tuple[Floats, Mask]:
        """Return where arms with joint targets (n, A) go once they hold their object.

        Returns:
            Joint angles (n, A) [rad], and whether the fingers let it go there, (n,).
        """
        places = self._state.positions[:, 0]
        goal = followed(path_of(self._rise, self._state.target, places), joints)
        return goal, np.zeros(len(joints), bool)

    def _after_release(self, joints: Floats) -> tuple[Floats, Mask]:
        """Return where arms with joint targets (n, A) go that have put their object down.

        Returns:
            Joint angles (n, A) [rad], and whether the object is put down, (n,).
        """
        return joints, np.zeros(len(joints), bool)

    def practice_point(
        self,
        episodes: Episodes,
        start: Floats,
        share: Floats,
        noise: Floats,
        choice: Floats,
    ) -> Floats:
        """Return joint angles on the approach, or before it, (k, J) [rad]."""
        approach = path_of(self._approach, episodes.target, episodes.position)
        point = (share[:, 0] * len(approach)).astype(np.int64)
        # Less noise near the object, which the fingers would push
        ends = (0, len(approach) - 1)
        spread = np.interp(point, ends, (PRACTICE_NOISE, NOISE_AT_GRASP))[:, None]
        rows = np.arange(len(point))
        on_approach = approach[point, rows] + spread * noise
        before = towards(approach[0], start, share) + PRACTICE_NOISE * noise
        return np.where(choice < ON_APPROACH, on_approach, before)


def path_of(tables: Sequence[GoalTable], objects: Integers, places: Floats) -> Floats:
    """Return ``POINTS`` points from each pose to the next, and the last pose, (W, n, J) [rad]."""
    poses = np.stack([table(objects, places) for table in tables])
    share = np.linspace(0.0, 1.0, POINTS, endpoint=False)[:, None, None]
    points = interpolate(poses[:-1, None], poses[1:, None], share)
    return np.concatenate([*points, poses[-1:]])


def followed(path: Floats, joints: Floats) -> Floats:
    """Return where arms with joint angles (n, A) go next on their paths (W, n, A), (n, A) [rad].

    It is `AHEAD` points after the one that is nearest.
    """
    nearest = _largest_errors(path, joints).argmin(axis=0)
    ahead = np.minimum(nearest + AHEAD, len(path) - 1)
    return path[ahead, np.arange(len(joints))]


def _largest_errors(points: Floats, joints: Floats) -> Floats:
    """Return the largest error of a joint at each point (W, n, J) [rad], (W, n) [rad]."""
    return np.abs(points - joints).max(axis=2)


def _next_point(error: Floats) -> Integers:
    """Return the point of the approach to aim at, (n,), from the error at each, (W, n)."""
    last = len(error) - 1
    nearest = error.argmin(axis=0)
    tolerance = np.linspace(*PASSED, len(error))
    is_passed = error < tolerance[:, None]
    # The last True of each column is the first one from behind.
    furthest = last - is_passed[::-1].argmax(axis=0)
    ahead = np.minimum(furthest + AHEAD, last)
    point = np.where(is_passed.any(axis=0), ahead, nearest)
    is_lost = error.min(axis=0) > LOST
    return np.where(is_lost, 0, point)
