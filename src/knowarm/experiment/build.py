"""Parts of an experiment, built from its config: environments, knowledge, policy, trainer."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from knowarm.experiment.algorithms import algorithms
from knowarm.experiment.config import INTERIM_SEED, ExperimentConfig, InterimConfig
from knowarm.experiment.knows import Knowledge
from knowarm.learn import Trainer
from knowarm.policy import Policy, PolicyConfig, PolicyShape
from knowarm.world.agents import AgentProtocol
from knowarm.world.agents.play import EpisodeResults, play
from knowarm.world.config import EnvConfig, robot_of
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.tasks.state import ACTION_LEVELS


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


def make_trainer(
    config: ExperimentConfig,
    policy: Policy,
    knowledge: Knowledge,
    **options: Any,
) -> Trainer:
    """Make the trainer of an experiment; ``options`` are those of `knowarm.learn.Trainer`."""
    return algorithms()[config.algorithm.name].make_trainer(
        config.algorithm,
        policy,
        seed=config.seed,
        make_env=partial(knowledge.make_env, config.env),
        make_evaluate=partial(
            interim_evaluation,
            config.env,
            config.interim,
            partial(knowledge.make_agent, greedy=True),
        ),
        **options,
    )


@dataclass(frozen=True)
class Parts:
    """The knowledge of an experiment and the configuration of its policy."""

    knowledge: Knowledge
    """Without a grounding network, which is trained later."""
    policy_config: PolicyConfig
    policy_shape: PolicyShape

    def new_policy(self, seed: int) -> Policy:
        """Initialize a policy; the same seed gives the same weights."""
        return Policy(self.policy_config, self.policy_shape, seed=seed)


def build(config: ExperimentConfig) -> Parts:
    """Compute the knowledge table of an experiment and the shape of its policy; nothing simulates.

    The table has a row per query in a task with queries, else per facet.
    """
    env = config.env
    knowledge = config.knows.known(env, config.seed)
    policy = _policy_config(config.policy, knowledge)
    shape = PolicyShape(
        joints=len(env.task.skill.joint_names(robot_of(env))),
        levels=len(ACTION_LEVELS),
        image_size=env.image_size,
        knowledge_dim=knowledge.width,
        knowledge_slots=knowledge.slots,
    )
    if policy.wide or policy.fusion == "none":
        knowledge = knowledge.unread()
    return Parts(knowledge, policy, shape)


def _policy_config(config: PolicyConfig, knowledge: Knowledge) -> PolicyConfig:
    """Return the choices of a policy with some knowledge.

    It trains vectors whose source gives them no meaning.
    """
    if knowledge.embedding is None:
        return replace(config, fusion="none")
    encoder = knowledge.embedding.config.source.encoder
    if encoder == "identity":
        return config
    return replace(config, knowledge_encoder=encoder)
