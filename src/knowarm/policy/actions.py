"""Factorized categorical action distribution: one softmax per joint.

Logits are (..., J, A), actions (..., J). Joints are independent, so log-probabilities and
entropies of an action are sums over the joints.
"""

import torch
from torch import Tensor


def sample(logits: Tensor, generator: torch.Generator) -> Tensor:
    """Draw one level per joint from softmax(logits), by the Gumbel-max trick: int64 (..., J)."""
    noise = torch.empty_like(logits).exponential_(generator=generator)
    return (logits - noise.log()).argmax(-1)


def greedy(logits: Tensor) -> Tensor:
    """Return the most probable level of every joint: int64 (..., J)."""
    return logits.argmax(-1)


def log_probabilities(logits: Tensor) -> Tensor:
    """Compute log softmax(logits) over the levels: (..., J, A).

    ``torch.log_softmax`` takes four times as long on rows of only A values.
    """
    return logits - logits.logsumexp(-1, keepdim=True)


def log_probability(logits: Tensor, actions: Tensor) -> Tensor:
    """Compute the log-probability of actions (..., J), summed over joints [nat]: (...)."""
    return log_probabilities(logits).gather(-1, actions[..., None]).squeeze(-1).sum(-1)


def entropy(logits: Tensor) -> Tensor:
    """Compute the entropy of the action distribution, summed over joints [nat]: (...)."""
    log_p = log_probabilities(logits)
    return -(log_p.exp() * log_p).sum((-2, -1))
