"""A policy's sizes and PPO's numbers go in; sb3-contrib's RecurrentPPO of the same comes out."""

import time
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from sb3_contrib import RecurrentPPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import SubprocVecEnv, VecEnv
from torch import Tensor, nn

from knowarm.learn import PPOConfig
from knowarm.policy import Policy
from knowarm.world.config import EnvConfig
from knowarm.world.knowledge_observation import KnowledgeObservation
from knowarm.world.single_env import ReachEnv


class PaperFeatures(BaseFeaturesExtractor):
    """The paper's convolutions and layer with the knowledge beside them, as the LSTM's input."""

    def __init__(self, observation_space: spaces.Dict, features: int) -> None:
        knowledge = int(np.prod(observation_space["knowledge"].shape or (0,)))
        super().__init__(observation_space, features + knowledge)
        self.image = nn.Sequential(
            nn.Conv2d(3, 16, 3, stride=4),
            nn.ReLU(),
            nn.Conv2d(16, 32, 5, stride=2),
            nn.ReLU(),
            nn.Flatten(),
            nn.LazyLinear(features),
            nn.ReLU(),
        )
        self.image(torch.zeros(1, *(observation_space["image"].shape or ())))

    def forward(self, observations: dict[str, Tensor]) -> Tensor:
        """(N, 3, H, W) scaled to 0..1 and (N, K) -> (N, features + K)."""
        return torch.cat((self.image(observations["image"]), observations["knowledge"]), 1)


def recurrent_ppo(policy: Policy, config: PPOConfig, env: VecEnv, *, seed: int) -> RecurrentPPO:
    """Build sb3-contrib's RecurrentPPO with a network, epochs and minibatches like ours.

    One LSTM serves actor and critic, and the heads are single layers, as in ours.
    """
    steps = config.rollout_steps * config.num_envs
    return RecurrentPPO(
        "MultiInputLstmPolicy",
        env,
        learning_rate=config.learning_rate,
        n_steps=steps // env.num_envs,
        batch_size=steps // config.minibatches,
        n_epochs=config.epochs,
        gamma=config.gamma,
        gae_lambda=config.gae_lambda,
        clip_range=config.clip_range,
        ent_coef=config.ent_coef,
        vf_coef=config.vf_coef,
        max_grad_norm=config.max_grad_norm,
        policy_kwargs={
            "features_extractor_class": PaperFeatures,
            "features_extractor_kwargs": {"features": policy.fc.out_features},
            "lstm_hidden_size": policy.hidden_size,
            "shared_lstm": True,
            "enable_critic_lstm": False,
            "net_arch": [],
        },
        seed=seed,
        device="cpu",
    )


def single_environments(config: EnvConfig, table: np.ndarray, count: int) -> VecEnv:
    """Make ``count`` single environments, each in a process, as Stable-Baselines3 does."""

    def make() -> KnowledgeObservation:
        return KnowledgeObservation(ReachEnv(**vars(config)), table)

    return SubprocVecEnv([make] * count, start_method="spawn")


class RolloutClock(BaseCallback):
    """Notes steps and time at the start of every rollout, and ends training in time.

    Args:
        seconds: how long to train for after the first rollout and update.
    """

    def __init__(self, seconds: float) -> None:
        super().__init__()
        self._seconds = seconds
        self.marks: list[tuple[int, float]] = []

    def _on_rollout_start(self) -> None:
        self.marks.append((self.num_timesteps, time.perf_counter()))

    def _on_step(self) -> bool:
        return len(self.marks) < 3 or self.marks[-1][1] - self.marks[1][1] < self._seconds


def parameter_count(model: Any) -> int:
    """Count the parameters of an SB3 model's policy."""
    return sum(p.numel() for p in model.policy.parameters())
