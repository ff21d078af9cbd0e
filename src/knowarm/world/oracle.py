"""Nothing but the world's true state goes in; actions that solve the task come out."""

import numpy as np
from numpy.typing import NDArray

from knowarm.world.env import ACTION_LEVELS, ReachVectorEnv
from knowarm.world.ik import InverseKinematics


class OracleAgent:
    """Looks at the grasp frame, not at the image, and goes there by inverse kinematics.

    It finds joint angles for the grasp frame once an episode and then, every step, takes for each
    joint the action that brings it nearest to them. It shows that a task can be solved with the
    seven actions; the score of an agent that sees images stands beside its.
    """

    def __init__(self, seed: int = 0) -> None:
        self._seed = seed

    def start(self, env: ReachVectorEnv) -> None:
        """Solve the inverse kinematics of every episode."""
        self._env = env
        self._levels = env.config.mpi_rad * np.array(ACTION_LEVELS)
        solver = InverseKinematics(env.scene, seed=self._seed)
        self._reach = solver.solve(env.grasp_position, env.grasp_matrix, env.joint_positions)

    def act(self, observations: NDArray[np.uint8]) -> NDArray[np.int64]:
        """Choose, for each joint, the action that ends nearest to its goal, (n, J)."""
        way = self._reach.joints - self._env.joint_targets
        return np.abs(way[..., None] - self._levels).argmin(axis=-1)
