"""Advantage actor-critic (A2C, Mnih et al. 2016) in one process: an algorithm of your own.

knowarm train irb120-full-a2c --algorithms a2c:A2C
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import torch

from knowarm import Algorithm, Policy
from knowarm.learn import (
    AlgorithmConfig,
    Checkpoint,
    Collector,
    Metrics,
    Rollout,
    SynchronousTrainer,
    TorchVectorEnv,
    advantages,
    policy_arrays,
)
from knowarm.policy import entropy, log_probability


@dataclass(frozen=True, kw_only=True)
class A2CConfig(AlgorithmConfig):
    """Hyperparameters; each is an option of the command line."""

    name: Literal["a2c"] = "a2c"  # tag in JSON and in the names of experiments
    num_envs: int = 128
    rollout_steps: int = 10
    learning_rate: float = 1e-3
    gamma: float = 0.95
    gae_lambda: float = 0.95
    vf_coef: float = 0.5
    ent_coef: float = 0.003
    reward_scale: float = 0.05
    max_grad_norm: float = 0.5


class A2CTrainer(SynchronousTrainer):
    """Collect a rollout, take one gradient step, and so on."""

    def __init__(
        self,
        config: A2CConfig,
        policy: Policy,
        env: TorchVectorEnv,
        *,
        seed: int,
        **options: Any,
    ) -> None:
        super().__init__(policy, seed=seed, **options)
        self.config = config
        self.collector = Collector(env, policy, seed=seed)
        self.rollout = Rollout.zeros(config.rollout_steps, config.num_envs, policy)
        self.optimizer = torch.optim.Adam(policy.parameters(), lr=config.learning_rate)

    def update(self, total_steps: int) -> Metrics:
        """Collect, learn, and return a row of ``metrics.csv``."""
        config, rollout = self.config, self.rollout
        self.collector.collect(rollout)
        self.step += rollout.reward.numel()
        reward = config.reward_scale * rollout.reward
        advantage = advantages(  # generalized advantage estimate, (T, B)
            reward,
            rollout.value,
            rollout.following(),
            rollout.done,
            config.gamma,
            config.gae_lambda,
        )
        logits, values, _ = self.policy.unroll(  # (T, B, J, A) and (T, B)
            rollout.patches,
            rollout.knowledge,
            rollout.start_state,
            rollout.episode_start,
        )
        policy_loss = -(log_probability(logits, rollout.action) * advantage).mean()
        value_loss = 0.5 * (advantage + rollout.value - values).square().mean()
        spread = entropy(logits).mean()
        loss = policy_loss + config.vf_coef * value_loss - config.ent_coef * spread
        self.optimizer.zero_grad()
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(
            self.policy.parameters(), config.max_grad_norm
        )
        self.optimizer.step()
        return {
            **self.collector.statistics.take().summary(),
            "policy_loss": policy_loss.item(),
            "value_loss": value_loss.item(),
            "entropy": spread.item(),
            "grad_norm": norm.item(),
        }

    def checkpoint(self) -> Checkpoint:
        """Return all that `restore` needs, as arrays."""
        state = self.optimizer.state_dict()["state"]
        return Checkpoint(
            policy=policy_arrays(self.policy),
            optimizer={
                f"{i}/{name}": value.numpy().copy()
                for i, values in state.items()
                for name, value in values.items()
            },
            state=self.collector.get_state(),
        )

    def restore(self, checkpoint: Checkpoint) -> None:
        """Continue from a checkpoint; the policy and ``step`` are restored already."""
        state: dict[int, dict[str, torch.Tensor]] = {}
        for place, array in checkpoint.optimizer.items():
            i, _, name = place.partition("/")
            state.setdefault(int(i), {})[name] = torch.from_numpy(np.array(array))
        self.optimizer.load_state_dict(self.optimizer.state_dict() | {"state": state})
        self.collector.set_state(checkpoint.state)


def make_a2c(
    config: A2CConfig, policy: Policy, *, make_env: Any, **options: Any
) -> A2CTrainer:
    """Make the environments and the trainer."""
    return A2CTrainer(config, policy, make_env(config.num_envs), **options)


A2C = Algorithm(
    about="advantage actor-critic in one process",
    config=A2CConfig(),
    make_trainer=make_a2c,
    total_steps=2_000_000,
    policy={"pixel_shift": 0.5, "pixel_scale": 4.0},  # images in -2 to 2
)
