"""Logits, values and what was observed go in; the named terms of each algorithm's loss come out.

Logits are (..., J, A), all else (...); every term is a mean over the leading axes, and entropies
and log-probabilities are sums over joints [nat].
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from knowarm.policy.actions import entropy, log_probability


@dataclass(frozen=True, kw_only=True)
class LossTerms:
    """Scalars of one loss; ``total`` is what is minimized."""

    total: Tensor
    policy: Tensor
    value: Tensor
    entropy: Tensor


@dataclass(frozen=True, kw_only=True)
class PPOLossTerms(LossTerms):
    """PPO's terms and how far the policy has moved since the rollout."""

    kl: Tensor
    """Estimate of KL(old, new) [nat]: mean of ratio - 1 - log ratio."""
    clipped: Tensor
    """Share of steps whose ratio was clipped."""


def a3c_loss(
    logits: Tensor,
    values: Tensor,
    actions: Tensor,
    advantages: Tensor,
    returns: Tensor,
    *,
    value_weight: float,
    entropy_weight: float,
) -> LossTerms:
    """A3C's loss (paper section 4.2.1), divided by the number of steps.

    ``policy = -mean(log pi(a) A)``, ``value = mean((R - V)^2) / 2`` and
    ``total = policy + value_weight * value - entropy_weight * entropy``: entropy is rewarded.
    The paper prints the opposite sign, under which a policy would be punished for exploring.
    """
    policy = -(log_probability(logits, actions) * advantages).mean()
    value = 0.5 * (returns - values).square().mean()
    spread = entropy(logits).mean()
    total = policy + value_weight * value - entropy_weight * spread
    return LossTerms(total=total, policy=policy, value=value, entropy=spread)


def ppo_loss(
    logits: Tensor,
    values: Tensor,
    actions: Tensor,
    old_log_probability: Tensor,
    advantages: Tensor,
    returns: Tensor,
    *,
    clip: float,
    value_weight: float,
    entropy_weight: float,
) -> PPOLossTerms:
    """PPO's clipped surrogate, value loss and entropy (Schulman et al. 2017, equations 7 and 9).

    ``policy = -mean(min(r A, clip(r, 1 - clip, 1 + clip) A))`` with ``r`` the ratio of new to old
    probability; ``value`` and ``total`` as in `a3c_loss`.
    """
    log_p = torch.log_softmax(logits, -1)
    log_ratio = log_p.gather(-1, actions[..., None]).squeeze(-1).sum(-1) - old_log_probability
    ratio = log_ratio.exp()
    surrogate = torch.min(ratio * advantages, ratio.clamp(1 - clip, 1 + clip) * advantages)
    policy = -surrogate.mean()
    value = 0.5 * (returns - values).square().mean()
    spread = -(log_p.exp() * log_p).sum((-2, -1)).mean()
    with torch.no_grad():
        kl = (ratio - 1 - log_ratio).mean()
        clipped = ((ratio - 1).abs() > clip).to(ratio.dtype).mean()
    return PPOLossTerms(
        total=policy + value_weight * value - entropy_weight * spread,
        policy=policy,
        value=value,
        entropy=spread,
        kl=kl,
        clipped=clipped,
    )
