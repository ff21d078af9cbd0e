"""Returns, advantages and losses of A3C, PPO and imitation: pure functions.

Logits are (..., J, A), actions (..., J), all else (...). Every term is a mean over the leading
axes; entropies and log-probabilities are sums over joints [nat].

Returns and advantages are (T, B) float32 tensors, flags (T, B) bool. The return of a *terminated*
episode ends with its last reward; that of a *truncated* one continues with the value of its final
observation. In both cases the next row belongs to another episode.
"""

import torch
from torch import Tensor

from knowarm.learn.algorithms import PPOConfig
from knowarm.learn.checkpoint import Tensors
from knowarm.policy.policy import (
    entropy,
    log_probabilities,
    log_probability,
    of_actions,
)

Terms = Tensors
"""Scalar terms of a loss by the name of their metric; ``total`` is minimized."""


def a3c_loss(
    logits: Tensor,
    values: Tensor,
    actions: Tensor,
    advantages: Tensor,
    returns: Tensor,
    *,
    vf_coef: float,
    ent_coef: float,
    weights: Tensor | None = None,
) -> Terms:
    """Compute A3C's loss (paper section 4.2.1), divided by the number of steps.

    ``policy = -mean(log pi(a) A)``, ``value = mean((R - V)^2) / 2`` and
    ``total = policy + vf_coef * value - ent_coef * entropy``: entropy is rewarded.
    The paper prints the opposite sign of the entropy term, which would penalize exploration.
    With ``weights`` of the steps (...) all means are weighted sums.
    """

    def mean(x: Tensor) -> Tensor:
        return x.mean() if weights is None else (x * weights).sum()

    policy = -mean(log_probability(logits, actions) * advantages)
    value = 0.5 * mean((returns - values).square())
    spread = mean(entropy(logits))
    total = policy + vf_coef * value - ent_coef * spread
    return {
        "total": total,
        "policy_loss": policy,
        "value_loss": value,
        "entropy": spread,
    }


def ppo_loss(
    logits: Tensor,
    values: Tensor,
    actions: Tensor,
    old_log_probability: Tensor,
    advantages: Tensor,
    returns: Tensor,
    config: PPOConfig,
) -> Terms:
    """Compute PPO's clipped surrogate loss (Schulman et al. 2017, equations 7 and 9).

    ``policy = -mean(min(r A, clip(r, 1 - clip_range, 1 + clip_range) A))`` with ``r`` the ratio of
    new to old probability; ``value`` and ``total`` as in `a3c_loss`. Also measured: the estimate
    mean(r - 1 - log r) of KL(old, new) [nat], and the fraction of steps whose ratio was clipped.
    """
    log_p = log_probabilities(logits)
    log_ratio = of_actions(log_p, actions).sum(-1) - old_log_probability
    ratio = log_ratio.exp()
    clipped = ratio.clamp(1 - config.clip_range, 1 + config.clip_range)
    policy = -torch.min(ratio * advantages, clipped * advantages).mean()
    value = 0.5 * (returns - values).square().mean()
    spread = -(log_p.exp() * log_p).sum((-2, -1)).mean()
    with torch.no_grad():
        approx_kl = (ratio - 1 - log_ratio).mean()
        clip_fraction = ((ratio - 1).abs() > config.clip_range).to(ratio.dtype).mean()
    return {
        "total": policy + config.vf_coef * value - config.ent_coef * spread,
        "policy_loss": policy,
        "value_loss": value,
        "entropy": spread,
        "approx_kl": approx_kl,
        "clip_fraction": clip_fraction,
    }


def distil_loss(
    logits: Tensor,
    teacher_actions: Tensor,
    weights: Tensor,
    stay_share: float,
) -> Tensor:
    """Compute the weighted mean cross-entropy per joint to the teacher's actions [nat].

    Every joint has a weight (..., J), and action 0 the share ``stay_share`` of each label.
    """
    log_p = log_probabilities(logits)
    taught = of_actions(log_p, teacher_actions)
    return (-taught.lerp(log_p[..., 0], stay_share) * weights).mean()


def next_values(
    values: Tensor,
    last_values: Tensor,
    final_values: Tensor,
    terminated: Tensor,
    truncated: Tensor,
) -> Tensor:
    """Return the value of the state after each step, within the same episode.

    ``final_values`` where truncated, 0 where terminated, else the next row's value;
    ``last_values`` (B,) follow the last row.
    """
    following = torch.cat((values[1:], last_values[None]))
    following = torch.where(truncated, final_values, following)
    return following.masked_fill(terminated, 0)


def n_step_returns(
    rewards: Tensor,
    following: Tensor,
    done: Tensor,
    gamma: float,
) -> Tensor:
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
