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


def log_probabilities(logits: Tensor) -> Tensor:
    """Log of softmax(logits) over the levels: shape (..., J, A).

    ``torch.log_softmax`` takes four times as long on rows of so few numbers.
    """
    return logits - logits.logsumexp(-1, keepdim=True)


def log_probability(logits: Tensor, actions: Tensor) -> Tensor:
    """Log-probability of whole actions (..., J): shape (...)."""
    return log_probabilities(logits).gather(-1, actions[..., None]).squeeze(-1).sum(-1)


def entropy(logits: Tensor) -> Tensor:
    """Entropy of whole actions [nat]: shape (...)."""
    log_p = log_probabilities(logits)
    return -(log_p.exp() * log_p).sum((-2, -1))
