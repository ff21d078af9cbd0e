"""Teacher: actions by inverse kinematics for episodes that a student plays, and practice starts."""

import logging
from copy import copy
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from knowarm.arrays import Floats, Integers
from knowarm.world.scene.scene import build_scene
from knowarm.world.tasks.sampling import Episodes, derive, uniforms
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
"""Tells the draws of practice starts from those of the episodes."""


class GoalTable:
    """Joint angles of each object's goal frame by the object's place, one branch per object.

    Arms reach a pose with several sets of joint angles. All nodes of an object are solved from the
    same reference, so that similar images have similar solutions; places between the nodes are
    interpolated.

    Args:
        state: episodes of the task.

    A warning tells the share of nodes without a solution if it is large.
    """

    def __init__(self, state: EpisodeState) -> None:
        self._state, robot = state, state.scene.robot
        count = len(state.scene.targets)
        self._low = np.array(robot.rectangle_centre_m) - np.array(robot.rectangle_half_size_m)
        size = 2 * np.array(robot.rectangle_half_size_m)
        self._cell = np.maximum(size / (NODES - 1), 1e-9)
        arm = build_scene(robot, state.scene.targets[:1])  # each object takes time and memory
        solver = partial(InverseKinematics.of_task, arm, state)
        every = np.arange(count)
        centre = np.tile(robot.rectangle_centre_m, (count, 1))
        reference = self._solve(solver(), every, centre, np.tile(arm.home, (count, 1))).joints
        axes = [
            low + step * np.arange(NODES) for low, step in zip(self._low, self._cell, strict=True)
        ]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        self._grid = objects, places = np.repeat(every, len(grid)), np.tile(grid, (count, 1))
        self._near = near = solver(starts=1)
        found = self._solve(near, objects, places, reference[objects], 1)
        missed = float((~found.within(REACHED_M, near.reached_deg)).mean())
        if missed > MISSED:
            log.warning("The teacher reaches %.0f %% of the places.", 100 * (1 - missed))
        self._joints = found.joints.reshape(count, NODES, NODES, -1)

    def shifted(self, shift: Floats) -> "GoalTable":
        """Return the table of goal frames moved by ``shift`` per object, (K, 3) [m]."""
        table, (objects, places) = copy(self), self._grid
        start = self._joints.reshape(len(objects), -1)
        found = self._solve(self._near, objects, places, start, 1, shift=shift)
        table._joints = found.joints.reshape(self._joints.shape)
        return table

    def __call__(self, objects: Integers, places: Floats) -> Floats:
        """Return the joint angles for objects (k,) at places (k, 2) [m], (k, J) [rad]."""
        scaled = ((places - self._low) / self._cell).clip(0, NODES - 1)
        corner = np.minimum(scaled.astype(np.int64), NODES - 2)
        (x, y), (i, j) = (scaled - corner).T[..., None], corner.T
        table = self._joints
        return np.asarray(
            (1 - x) * ((1 - y) * table[objects, i, j] + y * table[objects, i, j + 1])
            + x * ((1 - y) * table[objects, i + 1, j] + y * table[objects, i + 1, j + 1])
        )

    def _solve(
        self,
        solver: InverseKinematics,
        objects: Integers,
        places: Floats,
        start: Floats,
        *attempts: int,
        shift: Floats | None = None,
    ) -> IKSolution:
        position, matrix = self._state.goal_frames(objects, places)
        if shift is not None:
            position = position + shift[objects]
        return solver.solve(position, matrix, start, *attempts)


class Teacher:
    """Knows the joint angles that solve every running episode; an image is not looked at.

    It also moves the starts of a share of the episodes to the way from start to solution
    (`practice`), so that a student sees all of the way before it can follow it.

    Args:
        state: the episodes.

    Attributes:
        practice_share: share of the episodes that start on the way, 0 to 1.
    """

    def __init__(self, state: EpisodeState) -> None:
        self.goals = GoalTable(state)
        self.practice_share = 0.0
        self._state = state
        self._largest = state.increments[1]

    def restart(self) -> None:
        """Do nothing: the actions follow from the state alone."""

    def error(self) -> Floats:
        """Return the way from joint targets to solution in units of the largest step, (n, J)."""
        state = self._state
        goals = self.goals(state.target, state.positions[:, 0])
        return np.asarray((goals - state.joint_targets) / self._largest)

    def practice(
        self, episodes: Episodes, streams: NDArray[np.uint64], numbers: NDArray[np.uint64]
    ) -> Episodes:
        """Move the starts of a share of new episodes (k,) to noisy points on their way."""
        if not self.practice_share:
            return episodes
        scene = self._state.scene
        joints = len(scene.robot.joints)  # Fingers start open.
        draws = uniforms(streams ^ _STREAM, numbers, 3 + 2 * joints)
        radius = np.sqrt(-2 * np.log1p(-draws[:, 2 : 2 + joints]))
        noise = radius * np.cos(2 * np.pi * draws[:, 2 + joints : -1])  # Box and Muller 1958
        noise *= self._largest
        start = (scene.home + episodes.joint_offsets)[:, :joints]
        point = self.practice_point(episodes, start, draws[:, :1], noise, draws[:, -1:])
        point = point.clip(scene.joint_lower[:joints], scene.joint_upper[:joints])
        moved = draws[:, 1:2] < self.practice_share
        offsets = episodes.joint_offsets.copy()
        offsets[:, :joints] = np.where(moved, point - scene.home[:joints], offsets[:, :joints])
        return replace(episodes, joint_offsets=offsets)

    def practice_point(
        self, episodes: Episodes, start: Floats, share: Floats, noise: Floats, choice: Floats
    ) -> Floats:
        """Return joint angles on the way from start to solution, (k, J) [rad].

        ``share`` and ``choice`` are uniform draws (k, 1), ``noise`` has a standard deviation of one
        largest step, (k, J).
        """
        way = self.goals(episodes.target, episodes.position) - start
        # As the teacher moves: every joint by the largest step until it arrives.
        reached = share * np.abs(way).max(axis=1, keepdims=True)
        return np.asarray(start + way.clip(-reached, reached) + PRACTICE_NOISE * noise)
