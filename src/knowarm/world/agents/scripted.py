"""Agent protocol, agents that act by a fixed rule (zero, random, oracle), and blinding."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.tasks.guides import Guide
from knowarm.world.tasks.state import ACTION_LEVELS, nearest_levels


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

    In every step each joint takes the action that ends nearest to what the task's `Task.guide`
    says. It shows that a task can be solved with the seven actions, and its score is an upper
    reference for agents that see images.

    Args:
        seed: of the starting points of the solver.

    Attributes:
        guide: knows the way, from the first `start` on.
    """

    straight = False

    def __init__(self, seed: int = 0) -> None:
        self._seed = seed
        self._env: ArmVectorEnv | None = None
        self.guide: Guide

    def start(self, env: ArmVectorEnv) -> None:
        """Solve the inverse kinematics of every episode."""
        if self._env is not env:
            self._env = env
            self.guide = env.config.task.guide(env.running, self._seed, self.straight)
        self.guide.restart()

    def act(self, observations: NDArray[np.uint8]) -> NDArray[np.int64]:
        """Choose for each joint the action that ends nearest to its solution, (n, J)."""
        return nearest_levels(self.guide.error())


class ApproachAgent(OracleAgent):
    """Moves to the true goal frame along its approach direction, as a gripper has to."""

    straight = True


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
