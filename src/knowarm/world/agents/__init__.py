"""Scripted agents, blind agents, and the protocol of all agents."""

from collections.abc import Callable
from dataclasses import dataclass

from knowarm.world.agents.open_loop import search_open_loop
from knowarm.world.agents.protocol import AgentProtocol, Batch, PrivilegedAgent
from knowarm.world.agents.scripted import (
    ApproachAgent,
    BlindAgent,
    FrozenAgent,
    OpenLoopAgent,
    OracleAgent,
    RandomAgent,
    ZeroAgent,
)
from knowarm.world.envs.vector_env import ArmVectorEnv

__all__ = [
    "BLIND_AGENTS",
    "SCRIPTED_AGENTS",
    "AgentProtocol",
    "ApproachAgent",
    "Batch",
    "BlindAgent",
    "FrozenAgent",
    "OpenLoopAgent",
    "OracleAgent",
    "PrivilegedAgent",
    "RandomAgent",
    "ZeroAgent",
]


def searched_list(env: ArmVectorEnv, seed: int) -> OpenLoopAgent:
    """Return the agent that plays the best fixed list of actions for a task."""
    return OpenLoopAgent(search_open_loop(env.config, seed=seed))


@dataclass(frozen=True, kw_only=True)
class ScriptedAgent:
    """A scripted agent of the registry."""

    kind: type[ZeroAgent | RandomAgent | OpenLoopAgent | PrivilegedAgent]
    """Its class, whose ``inputs`` tell what it uses."""
    make: Callable[[ArmVectorEnv, int], AgentProtocol]
    """Creates the agent for an environment from a seed."""
    about: str
    """One line about it."""


SCRIPTED_AGENTS: dict[str, ScriptedAgent] = {
    "zero": ScriptedAgent(
        kind=ZeroAgent, make=lambda env, seed: ZeroAgent(), about="Never moves."
    ),
    "random": ScriptedAgent(
        kind=RandomAgent,
        make=lambda env, seed: RandomAgent(seed),
        about="Draws every action uniformly.",
    ),
    "open-loop": ScriptedAgent(
        kind=OpenLoopAgent,
        make=searched_list,
        about="Plays the fixed list of actions that solves most episodes; found by a search.",
    ),
    "oracle": ScriptedAgent(
        kind=OracleAgent,
        make=OracleAgent,
        about="Moves to the true grasp frame by inverse kinematics.",
    ),
    "approach": ScriptedAgent(
        kind=ApproachAgent,
        make=ApproachAgent,
        about="As the oracle, at the end along the frame's approach direction.",
    ),
}
"""Scripted agents by name."""


@dataclass(frozen=True, kw_only=True)
class BlindEntry:
    """A blind agent of the registry."""

    make: Callable[[AgentProtocol, ArmVectorEnv, int], AgentProtocol]
    """Creates the agent from the agent that it stands beside, its environment and a seed."""
    about: str
    """What it is, for a sentence."""
    sees_nothing: bool = True
    """Whether it receives no image at all."""


BLIND_AGENTS: dict[str, BlindEntry] = {
    "open-loop": BlindEntry(
        make=lambda agent, env, seed: searched_list(env, seed),
        about="the best fixed list of actions that a search found",
    ),
    "blind": BlindEntry(
        make=lambda agent, env, seed: BlindAgent(agent),
        about="the same network on black images",
    ),
    "frozen": BlindEntry(
        make=lambda agent, env, seed: FrozenAgent(agent),
        about="the same network, which sees only the first image of an episode",
        sees_nothing=False,
    ),
}
"""Blind agents by name: how much of a score depends on the image is the difference to them."""
