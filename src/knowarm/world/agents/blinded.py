"""Agents that play another agent without its eyes: on black images, or on the first image only."""

import numpy as np
from numpy.typing import NDArray

from knowarm.world.agents.scripted import AgentProtocol
from knowarm.world.envs.vector_env import ReachVectorEnv


class BlindAgent:
    """Plays an agent, which keeps its memory and its knowledge, on black images."""

    def __init__(self, agent: AgentProtocol) -> None:
        self._agent = agent

    def start(self, env: ReachVectorEnv) -> None:
        """Start the agent."""
        self._agent.start(env)

    def act(self, observations: NDArray[np.uint8]) -> NDArray[np.int64]:
        """Choose actions (n, J) for black images."""
        return self._agent.act(np.zeros_like(observations))


class FrozenAgent:
    """Plays an agent that sees the first image of an episode in every step."""

    def __init__(self, agent: AgentProtocol) -> None:
        self._agent = agent

    def start(self, env: ReachVectorEnv) -> None:
        """Start the agent and forget the images."""
        self._agent.start(env)
        self._first: NDArray[np.uint8] | None = None

    def act(self, observations: NDArray[np.uint8]) -> NDArray[np.int64]:
        """Choose actions (n, J) for the first images since the start."""
        if self._first is None:
            self._first = observations.copy()
        return self._agent.act(self._first)
