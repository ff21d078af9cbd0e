"""Logits (..., J, A) go in; actions (..., J), log-probabilities and entropies come out.

The joints choose independently, so log-probabilities and entropies are sums over joints.
"""

import torch
from torch import Tensor


def sample(logits: Tensor, generator: torch.Generator) -> Tensor:
    """Draw one level a joint from softmax(logits).

    The Gumbel-max trick: argmax of logits minus log of exponential draws.

    Returns:
        int64 (..., J).
    """
    noise = torch.empty_like(logits).exponential_(generator=generator)
    return (logits - noise.log()).argmax(-1)


def greedy(logits: Tensor) -> Tensor:
    """Take the most probable level of every joint: int64 (..., J)."""
    return logits.argmax(-1)


def log_probability(logits: Tensor, actions: Tensor) -> Tensor:
    """Log-probability of whole actions (..., J): shape (...)."""
    return torch.log_softmax(logits, -1).gather(-1, actions[..., None]).squeeze(-1).sum(-1)


def entropy(logits: Tensor) -> Tensor:
    """Entropy of whole actions [nat]: shape (...)."""
    log_p = torch.log_softmax(logits, -1)
    return -(log_p.exp() * log_p).sum((-2, -1))
