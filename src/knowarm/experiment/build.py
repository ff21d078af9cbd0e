"""An experiment's config goes in; its environments, knowledge table and policy come out."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from knowarm.experiment.config import ExperimentConfig, InterimConfig
from knowarm.knowledge.embedding import SceneEmbedding, scene_embedding
from knowarm.policy import Policy, PolicyConfig
from knowarm.policy.agent import PolicyAgent
from knowarm.policy.matched import matched_without_knowledge
from knowarm.world.env import ACTION_LEVELS, EnvConfig, ReachVectorEnv
from knowarm.world.episodes import evaluation_episodes
from knowarm.world.play import PlayResult, play


@dataclass(frozen=True)
class EnvFactory:
    """Makes vector environments of one config; picklable, so that workers can call it."""

    config: EnvConfig

    def __call__(self, num_envs: int, num_threads: int = 0) -> ReachVectorEnv:
        """Make ``num_envs`` environments on ``num_threads`` threads (0: one a core)."""
        return ReachVectorEnv(self.config, num_envs, num_threads=num_threads)


@dataclass(frozen=True)
class Parts:
    """What an experiment trains.

    Attributes:
        embedding: the knowledge with its names, coverage and norm.
        table: (F, K) float32, what the policy is given in an episode of each facet.
        policy_config: sizes of the network.
        facets: the environment's (object, colour) pairs, one a row of the table.
    """

    embedding: SceneEmbedding
    table: np.ndarray
    policy_config: PolicyConfig
    facets: tuple[tuple[str, str], ...]

    def new_policy(self, seed: int) -> Policy:
        """Draw a policy."""
        return Policy(self.policy_config, seed=seed)


def build(config: ExperimentConfig) -> Parts:
    """Embed the experiment's knowledge and size its network.

    Raises:
        UserError: the graph does not know an object, or the sizes do not fit.
    """
    env = EnvFactory(config.env)(1)
    embedding = scene_embedding(config.knowledge, env.facets)
    table = embedding.table(env.facets)
    policy_config = policy_sizes(config, env, embedding)
    if config.network.wide:
        table = table[:, :0]
    return Parts(embedding, table, policy_config, env.facets)


def policy_sizes(
    config: ExperimentConfig, env: ReachVectorEnv, embedding: SceneEmbedding
) -> PolicyConfig:
    """Sizes of the policy network for a robot, a image and a knowledge vector."""
    network = config.network
    sizes = PolicyConfig(
        joints=env.scene.num_joints,
        levels=len(ACTION_LEVELS),
        image_size=config.env.image_size,
        features=network.features,
        knowledge_dim=embedding.dim,
        knowledge_slots=max(1, embedding.dim // max(1, embedding.slot_dim)),
        knowledge_encoder=config.knowledge.source.encoder,
        fusion=network.fusion if embedding.dim else "none",
        hidden=network.hidden,
        pixel_shift=network.pixel_shift,
        pixel_scale=network.pixel_scale,
        actor_gain=network.actor_gain,
    )
    return matched_without_knowledge(sizes) if network.wide else sizes


@dataclass(frozen=True)
class InterimFactory:
    """Makes the function that plays the interim evaluation; picklable, so that it can be made in
    the process that evaluates.

    Attributes:
        env: the task, with the thresholds of training.
        interim: how many episodes, and which.
        table: (F, K) float32 knowledge.
    """

    env: EnvConfig
    interim: InterimConfig
    table: np.ndarray

    def __call__(self) -> Callable[[Policy], dict[str, float]]:
        """Make the environments and draw the episodes, once; return what plays them."""
        interim = self.interim
        env = ReachVectorEnv(self.env, interim.episodes)
        episodes = evaluation_episodes(env.scene, self.env, interim.episodes, interim.seed)

        def evaluate(policy: Policy) -> dict[str, float]:
            generator = torch.Generator().manual_seed(interim.seed)
            agent = PolicyAgent(policy, self.table, greedy=interim.greedy, generator=generator)
            return summarize(play(agent, env, episodes), self.env.success_distance_m)

        return evaluate


def summarize(result: PlayResult, success_distance_m: float) -> dict[str, float]:
    """Means over the episodes of one interim evaluation, at the thresholds of training.

    ``accuracy`` counts distance alone (paper equation 8), ``success`` distance and orientation.
    """
    return {
        "return_mean": float(result.episode_return.mean()),
        "return_std": float(result.episode_return.std()),
        "length_mean": float(result.length.mean()),
        "success": float(result.success.mean()),
        "accuracy": float((result.distance <= success_distance_m).mean()),
        "distance_mean": float(result.distance.mean()),
        "angle_mean": float(result.angle.mean()),
    }
