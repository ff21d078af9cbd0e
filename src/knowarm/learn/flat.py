"""A policy goes in; all its parameters and gradients as two vectors come out."""

import torch
from torch import Tensor, nn


class FlatParameters:
    """The parameters of a policy as one vector, in the order of ``named_parameters``.

    The policy's tensors become views: writing the vector changes the policy, and a backward
    pass fills the gradient vector.

    Args:
        policy: whose parameters; they keep their values and move to new memory.

    Attributes:
        values: (P,) float32.
        gradient: (P,) float32.
    """

    def __init__(self, policy: nn.Module) -> None:
        values = torch.cat([p.detach().flatten() for p in policy.parameters()])
        self._bind(policy, values, torch.zeros_like(values))

    @classmethod
    def at(cls, policy: nn.Module, values: Tensor, gradient: Tensor) -> "FlatParameters":
        """Bind a policy to two vectors (P,): it takes on the values that are there."""
        flat = cls.__new__(cls)
        flat._bind(policy, values, gradient)
        return flat

    def _bind(self, policy: nn.Module, values: Tensor, gradient: Tensor) -> None:
        self.values, self.gradient = values, gradient
        start = 0
        for parameter in policy.parameters():
            end = start + parameter.numel()
            parameter.data = values[start:end].view_as(parameter)
            parameter.grad = gradient[start:end].view_as(parameter)
            start = end

    def clip_gradient(self, limit: float) -> Tensor:
        """Shorten the gradient to ``limit``; return its norm before."""
        norm = torch.linalg.vector_norm(self.gradient)
        if norm > limit:
            self.gradient.mul_(limit / norm)
        return norm
