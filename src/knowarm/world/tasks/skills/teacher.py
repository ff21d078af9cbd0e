"""Teacher: actions by inverse kinematics for episodes that a student plays, and practice starts."""

import logging
from copy import copy
from dataclasses import replace
from itertools import product

import numpy as np

from knowarm.arrays import Floats, Integers
from knowarm.world.scene.scene import build_scene
from knowarm.world.tasks.sampling import Episodes, Words, derive, uniforms
from knowarm.world.tasks.skills.ik import REACHED_M, IKSolution, InverseKinematics
from knowarm.world.tasks.state import EpisodeState

log = logging.getLogger("knowarm.world")

NODES = 9
"""Places per side of the rectangle for which the teacher solves the inverse kinematics."""

MISSED = 0.1
"""Share of nodes without a solution above which the teacher warns."""

COARSE_LEVELS = 3
"""Number of levels that the teacher uses: none and the largest step in both directions. An image
does not show which of the smaller steps is the best one."""

PRACTICE_NOISE = 4.0
"""Standard deviation of the noise on every joint of a practice start, in largest steps."""

_STREAM = np.uint64(derive(0, "practice"))
"""Keeps the draws of practice starts apart from those of the episodes."""


class GoalTable:
    """Joint angles of each object's goal frame by the object's place, one branch per object.

    Arms reach a pose with several sets of joint angles. All nodes of an object are solved from the
    same reference, so that similar images have similar solutions; places between the nodes are
    interpolated.

    Args:
        state: episodes of the task.

    Logs a warning with the share of nodes that are reached if many are not.
    """

    def __init__(self, state: EpisodeState) -> None:
        robot = state.scene.robot
        targets = state.scene.targets
        centre = robot.rectangle_centre_m
        half_size = np.array(robot.rectangle_half_size_m)
        self._low = centre - half_size
        self._cell = np.maximum(2 * half_size / (NODES - 1), 1e-9)
        arm = build_scene(robot, targets[:1])  # each object takes time and memory
        # One solution per object, at the rectangle's centre, from which its nodes are solved
        numbers = np.arange(len(targets))
        copies = (len(targets), 1)
        position, matrix = state.goal_frames(numbers, np.tile(centre, copies))
        solver = InverseKinematics.of_task(arm, state)
        start = np.tile(arm.home, copies)
        reference = solver.solve(position, matrix, start).joints
        # Goal frames of each object at all nodes, (K * NODES^2, ...)
        x, y = self._low[:, None] + self._cell[:, None] * np.arange(NODES)
        nodes = np.array(list(product(x, y)))
        self._objects = np.repeat(numbers, len(nodes))
        places = np.tile(nodes, copies)
        self._position, self._matrix = state.goal_frames(self._objects, places)
        self._solver = InverseKinematics.of_task(arm, state, starts=1)
        solution = self._solve(self._position, reference[self._objects])
        is_reached = solution.within(REACHED_M, self._solver.reached_deg)
        missed = float((~is_reached).mean())
        if missed > MISSED:
            log.warning(
                "The teacher reaches %.0f %% of the places.", 100 * (1 - missed)
            )
        self._joints = solution.joints.reshape(len(targets), NODES, NODES, -1)

    def shifted(self, shift: Floats) -> "GoalTable":
        """Return the table of goal frames moved by ``shift`` per object, (K, 3) [m]."""
        start = self._joints.reshape(len(self._objects), -1)
        solution = self._solve(self._position + shift[self._objects], start)
        table = copy(self)
        table._joints = solution.joints.reshape(self._joints.shape)
        return table

    def __call__(self, objects: Integers, places: Floats) -> Floats:
        """Return the joint angles for objects (k,) at places (k, 2) [m], (k, J) [rad]."""
        # Bilinear interpolation between the four nodes (i, j) to (i + 1, j + 1) around a place
        scaled = (places - self._low) / self._cell
        scaled = scaled.clip(0, NODES - 1)
        corner = np.minimum(scaled.astype(np.int64), NODES - 2)
        i, j = corner.T
        x, y = (scaled - corner).T[..., None]
        joints = self._joints
        low = interpolate(joints[objects, i, j], joints[objects, i, j + 1], y)
        high = interpolate(joints[objects, i + 1, j], joints[objects, i + 1, j + 1], y)
        return interpolate(low, high, x)

    def _solve(self, position: Floats, start: Floats) -> IKSolution:
        """Solve for all nodes from joint angles ``start`` alone, to stay on their branch."""
        return self._solver.solve(position, self._matrix, start, 1)


class Teacher:
    """Computes the joint angles that solve every running episode, from its state without images.

    It also moves the starts of a share of the episodes onto the path from start to solution
    (`practice`), so that a student sees all of the path before it can follow it.

    Args:
        state: the episodes.

    Attributes:
        practice_share: share of the episodes that start on the path, 0 to 1.
    """

    def __init__(self, state: EpisodeState) -> None:
        self.goals = GoalTable(state)
        self.practice_share = 0.0
        self._state = state
        self._largest = state.increments[1]

    def error(self) -> Floats:
        """Return the way from joint targets to solution in units of the largest step, (n, J)."""
        state = self._state
        goals = self.goals(state.target, state.positions[:, 0])
        return (goals - state.joint_targets) / self._largest

    def practice(self, episodes: Episodes, streams: Words, numbers: Words) -> Episodes:
        """Move the starts of a share of new episodes (k,) to noisy points on their path."""
        if not self.practice_share:
            return episodes
        scene = self._state.scene
        joints = len(scene.robot.joints)  # Fingers start open.
        home = scene.home[:joints]
        draws = uniforms(streams ^ _STREAM, numbers, 3 + 2 * joints)
        ends = np.cumsum([1, 1, joints, joints])
        share, moved, radial, angular, choice = np.split(draws, ends, axis=1)
        is_moved = moved < self.practice_share
        # Normal noise of one largest step (Box and Muller 1958)
        radius = np.sqrt(-2 * np.log1p(-radial))
        noise = np.cos(2 * np.pi * angular)
        noise *= radius
        noise *= self._largest
        offsets = episodes.joint_offsets.copy()
        of_arm = offsets[:, :joints]  # A view, written below
        start = home + of_arm
        point = self.practice_point(episodes, start, share, noise, choice)
        point = point.clip(scene.joint_lower[:joints], scene.joint_upper[:joints])
        of_arm[:] = np.where(is_moved, point - home, of_arm)
        return replace(episodes, joint_offsets=offsets)

    def practice_point(
        self,
        episodes: Episodes,
        start: Floats,
        share: Floats,
        noise: Floats,
        choice: Floats,
    ) -> Floats:
        """Return joint angles on the path from start to solution, (k, J) [rad].

        ``share`` and ``choice`` are uniform draws (k, 1), ``noise`` has a standard deviation of one
        largest step, (k, J).
        """
        goals = self.goals(episodes.target, episodes.position)
        point = towards(goals, start, share)
        return point + PRACTICE_NOISE * noise


def interpolate(start: Floats, end: Floats, share: Floats) -> Floats:
    """Interpolate linearly: ``start`` at a share of 0, ``end`` at 1."""
    return (1 - share) * start + share * end


def towards(goals: Floats, start: Floats, share: Floats) -> Floats:
    """Return joint angles (k, J) after a share (k, 1) of the steps from ``start`` to ``goals``.

    As the teacher moves: every joint by the largest step until it arrives.
    """
    way = goals - start
    longest = np.abs(way).max(axis=1, keepdims=True)
    moved = share * longest
    return start + way.clip(-moved, moved)
