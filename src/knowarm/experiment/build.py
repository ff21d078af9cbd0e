"""Parts of an experiment: knowledge table, policy, environments and the interim evaluation."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from knowarm.config import to_dict
from knowarm.experiment.config import ExperimentConfig, InterimConfig
from knowarm.experiment.migration import split_network
from knowarm.knowledge.embedding import SceneEmbedding, scene_embedding
from knowarm.policy import Policy, PolicyConfig
from knowarm.policy.agent import PolicyAgent
from knowarm.policy.matched import matched_without_knowledge
from knowarm.world.config import EnvConfig
from knowarm.world.episodes import evaluation_episodes
from knowarm.world.play import EpisodeResults, play
from knowarm.world.tasks.reach import ACTION_LEVELS
from knowarm.world.vector_env import ReachVectorEnv


@dataclass(frozen=True)
class EnvFactory:
    """Factory of vector environments of one task; picklable, so that worker processes can use it.

    Attributes:
        config: the task.
    """

    config: EnvConfig

    def __call__(self, num_envs: int, num_threads: int = 0, *, device: str = "cpu") -> Any:
        """Make ``num_envs`` environments on a device, with ``num_threads`` threads (0: all)."""
        if device == "cpu":
            return ReachVectorEnv(self.config, num_envs, num_threads=num_threads)
        # Warp takes seconds to import.
        from knowarm.world.torch_env import TorchReachVectorEnv

        return TorchReachVectorEnv(self.config, num_envs, device=device)


@dataclass(frozen=True)
class Parts:
    """The knowledge of an experiment and the sizes of its policy.

    Attributes:
        embedding: the scene embedding with its names, coverage and norm.
        table: (F, K) float32, the policy's knowledge vector for each facet.
        policy_config: sizes of the network.
        facets: the environment's F (object, colour) pairs, one per row of the table.
    """

    embedding: SceneEmbedding
    table: np.ndarray
    policy_config: PolicyConfig
    facets: tuple[tuple[str, str], ...]

    def new_policy(self, seed: int) -> Policy:
        """Initialize a policy; the same seed gives the same weights."""
        return Policy(self.policy_config, seed=seed)

    def policy_description(self) -> dict[str, dict[str, Any]]:
        """Return the policy's choices and its shape as JSON values."""
        return split_network(to_dict(self.policy_config))


def build(config: ExperimentConfig) -> Parts:
    """Compute the knowledge table of an experiment and the sizes of its policy.

    Raises:
        UserError: the graph lacks an object, or the sizes do not fit together.
    """
    env = EnvFactory(config.env)(1)
    embedding = scene_embedding(config.knowledge, env.facets)
    table = embedding.table(env.facets)
    policy_config = policy_sizes(config, env, embedding)
    if config.policy.wide:
        table = table[:, :0]
    return Parts(embedding, table, policy_config, env.facets)


def policy_sizes(
    config: ExperimentConfig, env: ReachVectorEnv, embedding: SceneEmbedding
) -> PolicyConfig:
    """Sizes of the policy network for a robot, an image and a knowledge vector."""
    network = config.policy
    sizes = PolicyConfig(
        joints=env.scene.num_joints,
        levels=len(ACTION_LEVELS),
        image_size=config.env.image_size,
        features=network.features,
        knowledge_dim=embedding.dim,
        knowledge_slots=max(1, embedding.dim // max(1, embedding.slot_dim)),
        knowledge_encoder="learned" if config.knowledge.source == "learned" else "identity",
        fusion=network.fusion if embedding.dim else "none",
        hidden=network.hidden,
        pixel_shift=network.pixel_shift,
        pixel_scale=network.pixel_scale,
        actor_gain=network.actor_gain,
    )
    return matched_without_knowledge(sizes) if network.wide else sizes


@dataclass(frozen=True)
class InterimFactory:
    """Factory of the function that plays the interim evaluation.

    It is picklable, so that the evaluating process can call it.

    Attributes:
        env: the task, with the success thresholds of training.
        interim: number and seed of the episodes.
        table: (F, K) float32 knowledge table.
    """

    env: EnvConfig
    interim: InterimConfig
    table: np.ndarray

    def __call__(self) -> Callable[[Policy], dict[str, float]]:
        """Make the environments, draw the episodes, and return the evaluating function."""
        interim = self.interim
        env = ReachVectorEnv(self.env, interim.episodes)
        episodes = evaluation_episodes(env.scene, self.env, interim.episodes, interim.seed)

        def evaluate(policy: Policy) -> dict[str, float]:
            generator = torch.Generator().manual_seed(interim.seed)
            agent = PolicyAgent(policy, self.table, greedy=interim.greedy, generator=generator)
            return interim_numbers(play(agent, env, episodes), self.env.success_distance_m)

        return evaluate


def interim_numbers(result: EpisodeResults, success_distance_m: float) -> dict[str, float]:
    """Average the episodes of one interim evaluation, at the success thresholds of training.

    Args:
        result: the played episodes.
        success_distance_m: largest distance that counts for ``accuracy`` [m].

    Returns:
        Column of ``evaluations.csv`` to value: ``accuracy`` counts the distance only (paper
        equation 8), ``success`` distance and orientation.
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
