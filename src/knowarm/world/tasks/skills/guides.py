"""Guides: which way scripted agents take, by inverse kinematics once per episode."""

from typing import Protocol

import numpy as np

from knowarm.arrays import Floats
from knowarm.world.tasks.skills.ik import InverseKinematics
from knowarm.world.tasks.state import EpisodeState

APPROACH_M = 0.10  # Way of the gripper straight to the goal frame
WAYPOINTS = 8  # Poses of this way
NEAR = 0.05  # Joints within this share of the largest step of a pose have passed it


class Guide(Protocol):
    """Knows the way to the solution of every running episode."""

    def restart(self) -> None:
        """Prepare for new episodes: all environments were just reset."""

    def error(self) -> Floats:
        """Return the way from joint targets to the next pose in largest steps, (n, J)."""


class ShortestWay:
    """Moves every joint straight to its angle at the true goal frame."""

    def __init__(self, state: EpisodeState, seed: int) -> None:
        self._state = state
        self._solver = InverseKinematics.of_task(state.scene, state, seed=seed)

    def restart(self) -> None:
        """Solve the inverse kinematics of every episode."""
        self.go_to(self._state.goal_position, self._state.goal_matrix)

    def go_to(self, position: Floats, matrix: Floats) -> None:
        """Solve for other goal frames than the true ones, (n, 3) [m] and (n, 9)."""
        start = self._state.simulator.joint_positions
        self._goal = self._solver.solve(position, matrix, start).joints

    def error(self) -> Floats:
        """Return the way from joint targets to solution in largest steps, (n, J)."""
        return self._steps_to(self._goal)

    def _steps_to(self, joints: Floats) -> Floats:
        """Return the way from joint targets to joint angles (n, J) in largest steps, (n, J)."""
        return (joints - self._state.joint_targets) / self._state.increments[1]


class StraightApproach(ShortestWay):
    """Moves to a pose behind the goal frame, and then straight along the frame's z axis.

    On the shortest way of the joints, fingers can hit the object.
    """

    def restart(self) -> None:
        """Solve the inverse kinematics of the way of every episode."""
        super().restart()
        state = self._state
        back = -state.goal_matrix.reshape(-1, 3, 3)[:, :, 2]
        solver = InverseKinematics.of_task(state.scene, state, starts=1)
        distances = np.linspace(0.0, APPROACH_M, WAYPOINTS + 1)[1:]
        shifts = distances[:, None, None] * back
        way = solver.solve_way(
            state.goal_position, state.goal_matrix, self._goal, shifts
        )
        self._way = np.concatenate([way[::-1], self._goal[None]])
        self._next = np.zeros(len(back), np.int64)

    def error(self) -> Floats:
        """Return the way from joint targets to the next pose in largest steps, (n, J)."""
        rows = np.arange(len(self._next))
        error = self._steps_to(self._way[self._next, rows])
        is_near = np.abs(error).max(axis=1) < NEAR
        self._next = np.minimum(self._next + is_near, WAYPOINTS)
        return self._steps_to(self._way[self._next, rows])
