"""Agent protocol, agents that act by a fixed rule (zero, random, oracle), and blinding."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from knowarm.world.envs.running import joint_increments
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.tasks.ik import InverseKinematics
from knowarm.world.tasks.lift.teacher import make_teacher
from knowarm.world.tasks.state import ACTION_LEVELS
from knowarm.world.tasks.teacher import Teacher

APPROACH_M = 0.10  # Way of the gripper straight to the goal frame
WAYPOINTS = 8  # Poses of this way
NEAR = 20  # Joints within MPI / NEAR of a pose have passed it


class AgentProtocol(Protocol):
    """Chooses the actions of a vector environment, scripted or by a policy."""

    def start(self, env: ArmVectorEnv) -> None:
        """Prepare for new episodes: all environments of ``env`` were just reset."""

    def act(self, observations: NDArray[np.uint8]) -> NDArray[np.int64]:
        """Choose actions (n, J) in 0..6 from images (n, H, W, 3)."""


class ZeroAgent:
    """Never moves; as all scripted agents it is created from a seed."""

    def __init__(self, seed: int = 0) -> None:
        self._shape = (0, 0)

    def start(self, env: ArmVectorEnv) -> None:
        """Read the shape of the actions."""
        self._shape = (env.num_envs, env.scene.num_joints)

    def act(self, observations: NDArray[np.uint8]) -> NDArray[np.int64]:
        """Return the action without movement, (n, J)."""
        return np.zeros(self._shape, dtype=np.int64)


class RandomAgent:
    """Draws every action uniformly; a trained agent has to be better than this."""

    def __init__(self, seed: int = 0) -> None:
        self._generator = np.random.default_rng(seed)
        self._shape = (0, 0)

    def start(self, env: ArmVectorEnv) -> None:
        """Read the shape of the actions."""
        self._shape = (env.num_envs, env.scene.num_joints)

    def act(self, observations: NDArray[np.uint8]) -> NDArray[np.int64]:
        """Draw actions (n, J)."""
        return self._generator.integers(len(ACTION_LEVELS), size=self._shape)


class OracleAgent:
    """Moves to the true goal frame by inverse kinematics, without looking at the image.

    It solves for the joint angles of the goal frame once per episode; in every step each joint
    takes the action that ends nearest to its solution. It shows that a task can be solved with the
    seven actions, and its score is an upper reference for agents that see images.

    Where objects are solid it does what the task's teacher would do.

    Args:
        seed: of the starting points of the solver.
    """

    def __init__(self, seed: int = 0) -> None:
        self._seed = seed
        self._env: ArmVectorEnv | None = None
        self._teacher: Teacher | None = None

    def start(self, env: ArmVectorEnv) -> None:
        """Solve the inverse kinematics of every episode."""
        if env.config.task.solid:
            if self._teacher is None or self._env is not env:
                self._teacher = make_teacher(env.running)
            self._env = env
            return
        self._env = env
        self._levels = joint_increments(env.scene.robot, env.config)
        solver = InverseKinematics.of_task(env.scene, env.config, seed=self._seed)
        self._reach = solver.solve(env.goal_position, env.goal_matrix, env.joint_positions)

    def act(self, observations: NDArray[np.uint8]) -> NDArray[np.int64]:
        """Choose for each joint the action that ends nearest to its solution, (n, J)."""
        if self._teacher is not None:
            return self._teacher.actions(self._teacher.error(), len(ACTION_LEVELS))
        return self._towards(self._reach.joints)

    def _towards(self, joints: NDArray[np.float64]) -> NDArray[np.int64]:
        """Choose for each joint the action that ends nearest to an angle, (n, J)."""
        assert self._env is not None
        way = joints - self._env.joint_targets
        return np.abs(way[..., None] - self._levels).argmin(axis=-1)


class ApproachAgent(OracleAgent):
    """Moves to the true goal frame along its approach direction, as a gripper has to.

    The oracle takes the shortest way of the joints, on which fingers can hit the object. This agent
    first moves to a pose behind the goal frame and then straight along the frame's z axis.
    """

    def start(self, env: ArmVectorEnv) -> None:
        """Solve the inverse kinematics of the way of every episode."""
        super().start(env)
        if self._teacher is not None:
            return
        back = -env.goal_matrix.reshape(-1, 3, 3)[:, :, 2]
        solver = InverseKinematics.of_task(env.scene, env.config, starts=1)
        way = [self._reach.joints]
        for distance in np.linspace(0.0, APPROACH_M, WAYPOINTS + 1)[1:]:
            position = env.goal_position + distance * back
            way.append(solver.solve(position, env.goal_matrix, way[-1], attempts=1).joints)
        self._way = np.stack(way[::-1])
        self._next = np.zeros(env.num_envs, dtype=np.int64)

    def act(self, observations: NDArray[np.uint8]) -> NDArray[np.int64]:
        """Choose for each joint the action that ends nearest to the next pose, (n, J)."""
        if self._teacher is not None or self._env is None:
            return super().act(observations)
        rows = np.arange(len(self._next))
        way = self._way[self._next, rows] - self._env.joint_targets
        near = np.abs(way).max(axis=1) < self._levels.max() / NEAR
        self._next = np.minimum(self._next + near, WAYPOINTS)
        return self._towards(self._way[self._next, rows])


class BlindAgent:
    """Plays an agent, which keeps its memory and its knowledge, on black images."""

    def __init__(self, agent: AgentProtocol) -> None:
        self._agent = agent

    def start(self, env: ArmVectorEnv) -> None:
        """Start the agent."""
        self._agent.start(env)

    def act(self, observations: NDArray[np.uint8]) -> NDArray[np.int64]:
        """Choose actions (n, J) for black images."""
        return self._agent.act(np.zeros_like(observations))


class FrozenAgent:
    """Plays an agent that sees the first image of an episode in every step."""

    def __init__(self, agent: AgentProtocol) -> None:
        self._agent = agent

    def start(self, env: ArmVectorEnv) -> None:
        """Start the agent and forget the images."""
        self._agent.start(env)
        self._first: NDArray[np.uint8] | None = None

    def act(self, observations: NDArray[np.uint8]) -> NDArray[np.int64]:
        """Choose actions (n, J) for the first images since the start."""
        if self._first is None:
            self._first = observations.copy()
        return self._agent.act(self._first)
