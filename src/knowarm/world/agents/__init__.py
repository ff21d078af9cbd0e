"""Scripted agents: baselines that need no training, and the protocol of all agents."""

from collections.abc import Callable
from dataclasses import dataclass

from knowarm.world.agents.scripted import (
    AgentProtocol,
    OracleAgent,
    RandomAgent,
    ZeroAgent,
)

__all__ = ["SCRIPTED_AGENTS", "AgentProtocol", "OracleAgent", "RandomAgent", "ZeroAgent"]


@dataclass(frozen=True, kw_only=True)
class ScriptedAgent:
    """A scripted agent of the registry."""

    make: Callable[[int], AgentProtocol]
    """Creates the agent from a seed."""

    about: str
    """One line about it."""


SCRIPTED_AGENTS: dict[str, ScriptedAgent] = {
    "zero": ScriptedAgent(make=ZeroAgent, about="Never moves."),
    "random": ScriptedAgent(make=RandomAgent, about="Draws every action uniformly."),
    "oracle": ScriptedAgent(
        make=OracleAgent, about="Moves to the true grasp frame by inverse kinematics."
    ),
}
"""Scripted agents by name."""
