"""A seed goes in; an agent that needs no training comes out."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from knowarm.world.env import ACTION_LEVELS, ReachVectorEnv
from knowarm.world.oracle import OracleAgent
from knowarm.world.play import Agent


class ZeroAgent:
    """Never moves."""

    def start(self, env: ReachVectorEnv) -> None:
        """Learn how many joints there are."""
        self._shape = (env.num_envs, env.scene.num_joints)

    def act(self, observations: NDArray[np.uint8]) -> NDArray[np.int64]:
        """Stay, (n, J)."""
        return np.zeros(self._shape, dtype=np.int64)


class RandomAgent:
    """Draws every action uniformly; the floor any trained agent has to leave behind."""

    def __init__(self, seed: int = 0) -> None:
        self._generator = np.random.default_rng(seed)

    def start(self, env: ReachVectorEnv) -> None:
        """Learn how many joints there are; the draws go on."""
        self._shape = (env.num_envs, env.scene.num_joints)

    def act(self, observations: NDArray[np.uint8]) -> NDArray[np.int64]:
        """Draw actions (n, J)."""
        return self._generator.integers(len(ACTION_LEVELS), size=self._shape)


SCRIPTED: dict[str, Callable[[int], Agent]] = {
    "zero": lambda seed: ZeroAgent(),
    "random": RandomAgent,
    "oracle": OracleAgent,
}
"""Agents by name, each made from a seed."""
