"""A policy and some environments of a rollout go in; PPO's loss terms and gradient come out."""

from dataclasses import dataclass

import torch
from torch import Tensor

from knowarm.learn.config import PPOConfig
from knowarm.learn.losses import PPOLossTerms, ppo_loss
from knowarm.learn.rollout import Rollout
from knowarm.learn.shared import Shapes
from knowarm.policy import Policy


@dataclass(frozen=True)
class Targets:
    """What a rollout teaches."""

    advantage: Tensor
    """(T, B) float32."""
    returns: Tensor
    """(T, B) float32."""


def target_shapes(steps: int, batch: int) -> Shapes:
    """Shapes and types of the targets of T steps of B environments."""
    return dict.fromkeys(("advantage", "returns"), ((steps, batch), torch.float32))


def differentiate(
    policy: Policy,
    config: PPOConfig,
    table: Tensor,
    rollout: Rollout,
    targets: Targets,
    columns: Tensor,
    share: float = 1.0,
) -> PPOLossTerms:
    """Add the gradient of the loss of some environments to the policy's.

    Args:
        policy: its gradients are added to.
        config: weights of the terms.
        table: (F, K) float32 knowledge.
        rollout: T steps of B environments.
        targets: its targets.
        columns: (b,) int64, the environments.
        share: what the loss is multiplied by: b over the minibatch's number of environments.

    Returns:
        The terms times ``share``, so that those of a minibatch's parts add up to its own.
    """
    h, c = rollout.start_state
    logits, values, _ = policy.unroll(
        rollout.patches.index_select(1, columns),
        table[rollout.facet[:, columns]],
        (h[columns], c[columns]),
        rollout.episode_start[:, columns],
    )
    terms = ppo_loss(
        logits,
        values,
        rollout.action[:, columns],
        rollout.log_probability[:, columns],
        targets.advantage[:, columns],
        targets.returns[:, columns],
        clip_range=config.clip_range,
        vf_coef=config.vf_coef,
        ent_coef=config.ent_coef,
    )
    (terms.total * share).backward()
    return terms.times(share)
