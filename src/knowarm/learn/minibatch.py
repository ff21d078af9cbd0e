"""Minibatch gradient: PPO's loss and its gradient over some environments of a rollout."""

from dataclasses import dataclass

import torch
from torch import Tensor

from knowarm.learn.config import PPOConfig
from knowarm.learn.losses import PPOLossTerms, ppo_loss
from knowarm.learn.rollout import Rollout
from knowarm.learn.shared_tensors import TensorSpecs
from knowarm.policy import Policy


@dataclass(frozen=True)
class Targets:
    """Targets of PPO's loss for one rollout."""

    advantage: Tensor
    """(T, B) float32."""
    returns: Tensor
    """(T, B) float32."""


def target_specs(steps: int, batch: int) -> TensorSpecs:
    """Return shapes and dtypes of the targets of T steps of B environments."""
    return dict.fromkeys(("advantage", "returns"), ((steps, batch), torch.float32))


def add_gradient(
    policy: Policy,
    config: PPOConfig,
    rollout: Rollout,
    targets: Targets,
    env_ids: Tensor,
    weight: float = 1.0,
) -> PPOLossTerms:
    """Add the gradient of the loss over some environments to the policy's gradients.

    Args:
        policy: its gradients are added to.
        config: weights of the loss terms.
        rollout: T steps of B environments.
        targets: of the rollout.
        env_ids: (b,) int64, the environments.
        weight: factor of the loss: b over the number of environments in the whole minibatch.

    Returns:
        The terms times ``weight``, so that the terms of a minibatch's parts add up to its own.
    """
    h, c = rollout.start_state
    logits, values, _ = policy.unroll(
        rollout.patches.index_select(1, env_ids),
        rollout.facet[:, env_ids],
        (h[env_ids], c[env_ids]),
        rollout.episode_start[:, env_ids],
    )
    terms = ppo_loss(
        logits,
        values,
        rollout.action[:, env_ids],
        rollout.log_probability[:, env_ids],
        targets.advantage[:, env_ids],
        targets.returns[:, env_ids],
        clip_range=config.clip_range,
        vf_coef=config.vf_coef,
        ent_coef=config.ent_coef,
    )
    (terms.total * weight).backward()
    return terms.scaled(weight)
