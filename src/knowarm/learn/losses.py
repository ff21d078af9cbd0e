"""Returns, advantages and losses of A3C and PPO: pure functions.

Logits are (..., J, A), actions (..., J), all else (...). Every term is a mean over the leading
axes; entropies and log-probabilities are sums over joints [nat].

Returns and advantages are (T, B) float32 tensors, flags (T, B) bool. The return of a *terminated*
episode ends with its last reward; that of a *truncated* one continues with the value of its final
observation. In both cases the next row belongs to another episode.
"""

from dataclasses import dataclass, fields

import torch
from torch import Tensor

from knowarm.policy.policy import entropy, log_probabilities, log_probability


@dataclass(frozen=True, kw_only=True)
class LossTerms:
    """Scalar terms of a loss; ``total`` is minimized."""

    total: Tensor
    policy: Tensor
    value: Tensor
    entropy: Tensor


@dataclass(frozen=True, kw_only=True)
class PPOLossTerms(LossTerms):
    """Terms of PPO's loss and measures of the policy's change since the rollout."""

    approx_kl: Tensor  # Estimate of KL(old, new) [nat]: mean of ratio - 1 - log ratio
    auxiliary: Tensor  # Mean squared error of the auxiliary head; 0 without one
    clip_fraction: Tensor  # Fraction of steps whose ratio was clipped
    # Weighted mean cross-entropy per joint to the teacher's actions [nat]; 0 without a teacher
    imitation: Tensor

    @classmethod
    def names(cls) -> list[str]:
        """Return the names of the terms in the order of `vector`."""
        return [field.name for field in fields(cls)]

    def vector(self) -> Tensor:
        """Return all terms as one tensor, detached."""
        return torch.stack([getattr(self, name).detach() for name in self.names()])

    @classmethod
    def from_vector(cls, vector: Tensor) -> "PPOLossTerms":
        """Build the terms from a `vector`."""
        return cls(**dict(zip(cls.names(), vector, strict=True)))

    def scaled(self, factor: float) -> "PPOLossTerms":
        """Return every term times a factor, detached."""
        return self.from_vector(self.vector() * factor)


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
    """Compute A3C's loss (paper section 4.2.1), divided by the number of steps.

    ``policy = -mean(log pi(a) A)``, ``value = mean((R - V)^2) / 2`` and
    ``total = policy + vf_coef * value - ent_coef * entropy``: entropy is rewarded.
    The paper prints the opposite sign of the entropy term, which would penalize exploration.
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
    auxiliary: Tensor | None = None,
    auxiliary_coef: float = 0.0,
    teacher_actions: Tensor | None = None,
    teacher_weight: Tensor | None = None,
    imitation_coef: float = 0.0,
    imitation_stay: float = 0.0,
    reinforcement_coef: float = 1.0,
) -> PPOLossTerms:
    """Compute PPO's clipped surrogate loss (Schulman et al. 2017, equations 7 and 9).

    ``policy = -mean(min(r A, clip(r, 1 - clip_range, 1 + clip_range) A))`` with ``r`` the ratio of
    new to old probability; ``value`` and ``total`` as in `a3c_loss`, times ``reinforcement_coef``,
    plus ``auxiliary_coef`` times the ``auxiliary`` loss and ``imitation_coef`` times the
    cross-entropy to ``teacher_actions``, in which every joint has its ``teacher_weight`` (..., J),
    and action 0 the share ``imitation_stay`` of each label.
    """
    log_p = log_probabilities(logits)
    # Imitation alone needs the other terms as metrics only.
    with torch.set_grad_enabled(reinforcement_coef > 0 or not imitation_coef):
        log_ratio = log_p.gather(-1, actions[..., None]).squeeze(-1).sum(-1) - old_log_probability
        ratio = log_ratio.exp()
        clipped = ratio.clamp(1 - clip_range, 1 + clip_range)
        policy = -torch.min(ratio * advantages, clipped * advantages).mean()
        value = 0.5 * (returns - values).square().mean()
        spread = -(log_p.exp() * log_p).sum((-2, -1)).mean()
        total = reinforcement_coef * (policy + vf_coef * value - ent_coef * spread)
    with torch.no_grad():
        approx_kl = (ratio - 1 - log_ratio).mean()
        clip_fraction = ((ratio - 1).abs() > clip_range).to(ratio.dtype).mean()
    if auxiliary is None:
        auxiliary = torch.zeros_like(total)
    else:
        total = total + auxiliary_coef * auxiliary
    if teacher_actions is None:
        imitation = torch.zeros_like(total)
    else:
        taught = log_p.gather(-1, teacher_actions[..., None]).squeeze(-1)
        surprise = -taught.lerp(log_p[..., 0], imitation_stay)
        imitation = (surprise if teacher_weight is None else surprise * teacher_weight).mean()
        total = total + imitation_coef * imitation
    return PPOLossTerms(
        total=total,
        auxiliary=auxiliary,
        policy=policy,
        value=value,
        entropy=spread,
        approx_kl=approx_kl,
        clip_fraction=clip_fraction,
        imitation=imitation,
    )


def next_values(
    values: Tensor, last_values: Tensor, final_values: Tensor, terminated: Tensor, truncated: Tensor
) -> Tensor:
    """Return the value of the state after each step, within the same episode.

    ``final_values`` where truncated, 0 where terminated, else the next row's value;
    ``last_values`` (B,) follow the last row.
    """
    following = torch.cat((values[1:], last_values[None]))
    following = torch.where(truncated, final_values, following)
    return torch.where(terminated, torch.zeros_like(following), following)


def n_step_returns(rewards: Tensor, following: Tensor, done: Tensor, gamma: float) -> Tensor:
    """Compute n-step returns: discounted rewards until episode or rollout ends, then the value.

    ``R_t = r_t + gamma R_{t+1}``, with ``following`` in place of ``R_{t+1}`` in the last row and
    where ``done`` (paper section 4.2.1; Mnih et al. 2016).
    """
    returns = torch.empty_like(rewards)
    future = following[-1]
    for t in reversed(range(len(rewards))):
        future = rewards[t] + gamma * torch.where(done[t], following[t], future)
        returns[t] = future
    return returns


def advantages(
    rewards: Tensor,
    values: Tensor,
    following: Tensor,
    done: Tensor,
    gamma: float,
    gae_lambda: float,
) -> Tensor:
    """Compute generalized advantage estimates (paper equations 3 and 4).

    ``delta_t = r_t + gamma V(s_{t+1}) - V(s_t)``, ``A_t = delta_t + gamma lambda A_{t+1}``, the
    sum restarted where ``done``.
    """
    deltas = rewards + gamma * following - values
    decay = gamma * gae_lambda * (~done).to(rewards.dtype)
    result = torch.empty_like(rewards)
    carried = torch.zeros_like(rewards[0])
    for t in reversed(range(len(rewards))):
        carried = deltas[t] + decay[t] * carried
        result[t] = carried
    return result
