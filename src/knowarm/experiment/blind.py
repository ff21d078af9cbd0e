"""Blind baselines beside a trained agent: how much of its success depends on vision."""

from typing import Any

import numpy as np

from knowarm.experiment.config import EvaluationConfig
from knowarm.statistics import share_difference, wilson
from knowarm.world.agents import BLIND_AGENTS, AgentProtocol
from knowarm.world.agents.play import play
from knowarm.world.envs.vector_env import ReachVectorEnv
from knowarm.world.tasks.episodes import Episodes


def count_blind_episodes(config: EvaluationConfig) -> int:
    """Count the episodes that all blind agents play in an evaluation."""
    return len(BLIND_AGENTS) * min(config.blind_episodes, config.episodes)


def blind_numbers(
    agent: AgentProtocol,
    success: np.ndarray,
    env: ReachVectorEnv,
    episodes: Episodes,
    count: int,
    seed: int,
) -> dict[str, Any]:
    """Play the first ``count`` of an agent's N episodes with the blind agents, and compare.

    ``success`` (N,) bool is the agent's. Returns ``blind_agents``, by name the ``episodes``,
    ``success`` and ``difference``, the agent's success over all episodes minus this one, and
    ``needs_eyes``, the smallest difference to an agent that sees nothing; 95 % intervals.
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
            **share.named("success"),
            **differences[name].named("difference"),
        }
    needs_eyes = min(
        (differences[name] for name, entry in BLIND_AGENTS.items() if entry.sees_nothing),
        key=lambda difference: difference.estimate,
    )
    return {"blind_agents": numbers, **needs_eyes.named("needs_eyes")}
