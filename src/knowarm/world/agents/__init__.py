"""Scripted agents, blind agents, and the protocol of all agents."""

from collections.abc import Callable
from dataclasses import dataclass

from knowarm.world.agents.open_loop import OpenLoopAgent
from knowarm.world.agents.scripted import (
    AgentProtocol,
    ApproachAgent,
    BlindAgent,
    FrozenAgent,
    OracleAgent,
    RandomAgent,
    ZeroAgent,
)

__all__ = [
    "BLIND_AGENTS",
    "SCRIPTED_AGENTS",
    "AgentProtocol",
    "ApproachAgent",
    "BlindAgent",
    "FrozenAgent",
    "OpenLoopAgent",
    "OracleAgent",
    "RandomAgent",
    "ZeroAgent",
]


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
    "open-loop": ScriptedAgent(
        make=OpenLoopAgent,
        about="Plays the fixed list of actions that solves most episodes; found by a search.",
    ),
    "oracle": ScriptedAgent(
        make=OracleAgent, about="Moves to the true grasp frame by inverse kinematics."
    ),
    "approach": ScriptedAgent(
        make=ApproachAgent, about="As the oracle, at the end along the frame's approach direction."
    ),
}
"""Scripted agents by name."""


@dataclass(frozen=True, kw_only=True)
class BlindEntry:
    """A blind agent of the registry."""

    make: Callable[[AgentProtocol, int], AgentProtocol]
    """Creates the agent from the agent that it stands beside, and a seed."""
    about: str
    """What it is, for a sentence."""
    sees_nothing: bool = True
    """Whether it receives no image at all."""


BLIND_AGENTS: dict[str, BlindEntry] = {
    "open-loop": BlindEntry(
        make=lambda agent, seed: OpenLoopAgent(seed),
        about="the best fixed list of actions that a search found",
    ),
    "blind": BlindEntry(
        make=lambda agent, seed: BlindAgent(agent), about="the same network on black images"
    ),
    "frozen": BlindEntry(
        make=lambda agent, seed: FrozenAgent(agent),
        about="the same network, which sees only the first image of an episode",
        sees_nothing=False,
    ),
}
"""Blind agents by name: how much of a score depends on the image is the difference to them."""
