"""Blind agents beside a trained one: how much of its success needs eyes."""

from typing import Any

import numpy as np

from knowarm.experiment.config import EvaluationConfig
from knowarm.statistics import Interval, share_difference, wilson
from knowarm.world.agents import BLIND_AGENTS, AgentProtocol
from knowarm.world.agents.open_loop import search_open_loop
from knowarm.world.config import EnvConfig
from knowarm.world.episodes import Episodes
from knowarm.world.play import play
from knowarm.world.vector_env import ReachVectorEnv


def count_blind_episodes(config: EvaluationConfig) -> int:
    """Count the episodes that all blind agents play in an evaluation."""
    return len(BLIND_AGENTS) * min(config.blind_episodes, config.episodes)


def prepare_blind_agents(env: EnvConfig) -> None:
    """Search for the open-loop agent of a task, which takes longer than its episodes."""
    search_open_loop(env)


def blind_numbers(
    agent: AgentProtocol,
    success: np.ndarray,
    env: ReachVectorEnv,
    episodes: Episodes,
    count: int,
    seed: int,
) -> dict[str, Any]:
    """Play the first of an agent's episodes with the blind agents, and subtract their success.

    Args:
        agent: the evaluated agent, as `BlindAgent` and `FrozenAgent` play it.
        success: which of its episodes it solved, (N,) bool.
        env: the environment, with the evaluation's thresholds.
        episodes: the N episodes it played.
        count: number of episodes that each blind agent plays.
        seed: of the search for the open-loop agent.

    Returns:
        ``blind_agents``: for each name in `BLIND_AGENTS` the number of ``episodes``, ``success``
        and ``difference``, the agent's success over all its episodes minus this one.
        ``needs_eyes``: the smallest difference to an agent that sees nothing. Rates and
        differences have 95 % intervals. Nothing without episodes.
    """
    if not count:
        return {}
    chosen = episodes[:count]
    own = wilson(int(np.count_nonzero(success)), len(success))
    numbers: dict[str, dict[str, Any]] = {}
    differences = {}
    for name, entry in BLIND_AGENTS.items():
        solved = play(entry.make(agent, seed), env, chosen).success
        share = wilson(int(np.count_nonzero(solved)), len(solved))
        differences[name] = share_difference(own, share)
        numbers[name] = {
            "episodes": len(solved),
            **_cells("success", share),
            **_cells("difference", differences[name]),
        }
    needs_eyes = min(
        (differences[name] for name, entry in BLIND_AGENTS.items() if entry.sees_nothing),
        key=lambda difference: difference.estimate,
    )
    return {"blind_agents": numbers, **_cells("needs_eyes", needs_eyes)}


def _cells(name: str, value: Interval) -> dict[str, float]:
    return {name: value.estimate, f"{name}_low": value.low, f"{name}_high": value.high}
