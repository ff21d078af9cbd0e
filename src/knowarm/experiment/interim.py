"""Interim evaluations, also in a process of their own, which imports nothing that trains."""

from collections.abc import Callable
from typing import Any

from knowarm.experiment.config import INTERIM_SEED, InterimConfig
from knowarm.world.agents import AgentProtocol
from knowarm.world.agents.play import EpisodeResults, play
from knowarm.world.config import EnvConfig
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv


def interim_evaluation(
    config: EnvConfig,
    interim: InterimConfig,
    make_agent: Callable[[Any], AgentProtocol],
) -> Callable[[Any], dict[str, float]]:
    """Make the environments, draw the episodes, and return the function that plays a policy."""
    env = ArmVectorEnv(config, interim.episodes)
    episodes = evaluation_episodes(config, interim.episodes, INTERIM_SEED)
    task = config.task
    setting = env.running.setting

    def evaluate(policy: Any) -> dict[str, float]:
        result = play(make_agent(policy), env, episodes)
        numbers = _numbers(result, config.success_distance_m)
        columns = task.columns(setting, result.infos)
        for measure in task.measures:
            if measure.column in columns and measure.among is None:
                numbers[measure.name] = columns[measure.column].mean()
        return {name: float(number) for name, number in numbers.items()}

    return evaluate


def _numbers(result: EpisodeResults, success_distance_m: float) -> dict[str, Any]:
    """Return the columns of ``evaluations.csv``, averages over the episodes.

    ``accuracy`` counts the distance only (paper equation 8), ``success`` distance and orientation.
    """
    is_accurate = result.distance <= success_distance_m
    return {
        "return_mean": result.episode_return.mean(),
        "return_std": result.episode_return.std(),
        "length_mean": result.length.mean(),
        "success": result.success.mean(),
        "accuracy": is_accurate.mean(),
        "distance_mean": result.distance.mean(),
        "angle_mean": result.angle.mean(),
    }
