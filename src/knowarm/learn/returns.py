"""Returns and generalized advantage estimates.

All arrays are (T, B) float32 tensors, flags are (T, B) bool. The return of a *terminated*
episode ends with its last reward; that of a *truncated* one continues with the value of its final
observation. In both cases the next row belongs to another episode.
"""

import torch
from torch import Tensor


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
