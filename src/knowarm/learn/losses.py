"""Logits, values and what was observed go in; the named terms of each algorithm's loss come out.

Logits are (..., J, A), all else (...); every term is a mean over the leading axes, and entropies
and log-probabilities are sums over joints [nat].
"""

from dataclasses import dataclass, fields

import torch
from torch import Tensor

from knowarm.policy.actions import entropy, log_probabilities, log_probability


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

    @classmethod
    def names(cls) -> list[str]:
        """Names of the terms, in the order of `vector`."""
        return [field.name for field in fields(cls)]

    def vector(self) -> Tensor:
        """All terms as one tensor, without gradients."""
        return torch.stack([getattr(self, name).detach() for name in self.names()])

    @classmethod
    def from_vector(cls, vector: Tensor) -> "PPOLossTerms":
        """Return the terms that made a `vector`, which is copied."""
        return cls(**dict(zip(cls.names(), vector.clone(), strict=True)))

    def times(self, share: float) -> "PPOLossTerms":
        """Every term times a number, without gradients."""
        return PPOLossTerms(**{name: term.detach() * share for name, term in vars(self).items()})

    def __add__(self, other: "PPOLossTerms") -> "PPOLossTerms":
        """Every term added to the other's: the terms of a batch from those of its parts."""
        return PPOLossTerms(
            **{name: term + getattr(other, name) for name, term in vars(self).items()}
        )


def a3c_loss(
    logits: Tensor,
    values: Tensor,
    actions: Tensor,
    advantages: Tensor,
    returns: Tensor,
    *,
    vf_coef: float,
    ent_coef: float,
) -> LossTerms:
    """A3C's loss (paper section 4.2.1), divided by the number of steps.

    ``policy = -mean(log pi(a) A)``, ``value = mean((R - V)^2) / 2`` and
    ``total = policy + vf_coef * value - ent_coef * entropy``: entropy is rewarded.
    The paper prints the opposite sign, under which a policy would be punished for exploring.
    """
    policy = -(log_probability(logits, actions) * advantages).mean()
    value = 0.5 * (returns - values).square().mean()
    spread = entropy(logits).mean()
    total = policy + vf_coef * value - ent_coef * spread
    return LossTerms(total=total, policy=policy, value=value, entropy=spread)


def ppo_loss(
    logits: Tensor,
    values: Tensor,
    actions: Tensor,
    old_log_probability: Tensor,
    advantages: Tensor,
    returns: Tensor,
    *,
    clip_range: float,
    vf_coef: float,
    ent_coef: float,
) -> PPOLossTerms:
    """PPO's clipped surrogate, value loss and entropy (Schulman et al. 2017, equations 7 and 9).

    ``policy = -mean(min(r A, clip(r, 1 - clip_range, 1 + clip_range) A))`` with ``r`` the ratio of
    new to old probability; ``value`` and ``total`` as in `a3c_loss`.
    """
    log_p = log_probabilities(logits)
    log_ratio = log_p.gather(-1, actions[..., None]).squeeze(-1).sum(-1) - old_log_probability
    ratio = log_ratio.exp()
    surrogate = torch.min(
        ratio * advantages, ratio.clamp(1 - clip_range, 1 + clip_range) * advantages
    )
    policy = -surrogate.mean()
    value = 0.5 * (returns - values).square().mean()
    spread = -(log_p.exp() * log_p).sum((-2, -1)).mean()
    with torch.no_grad():
        kl = (ratio - 1 - log_ratio).mean()
        clipped = ((ratio - 1).abs() > clip_range).to(ratio.dtype).mean()
    return PPOLossTerms(
        total=policy + vf_coef * value - ent_coef * spread,
        policy=policy,
        value=value,
        entropy=spread,
        kl=kl,
        clipped=clipped,
    )
