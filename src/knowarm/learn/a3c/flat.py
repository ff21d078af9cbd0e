"""A policy goes in; all its parameters and gradients as two vectors come out."""

import torch
from torch import Tensor, nn


class FlatParameters:
    """The parameters of a policy as one vector, in the order of ``named_parameters``.

    The policy's tensors become views: writing the vector changes the policy, and a backward
    pass fills the gradient vector.

    Attributes:
        values: (P,) float32.
        gradient: (P,) float32.
    """

    def __init__(self, policy: nn.Module) -> None:
        parameters = list(policy.parameters())
        self.values = torch.cat([p.detach().flatten() for p in parameters])
        self.gradient = torch.zeros_like(self.values)
        start = 0
        for parameter in parameters:
            end = start + parameter.numel()
            parameter.data = self.values[start:end].view_as(parameter)
            parameter.grad = self.gradient[start:end].view_as(parameter)
            start = end

    def clip_gradient(self, limit: float) -> Tensor:
        """Shorten the gradient to ``limit``; return its norm before."""
        norm = torch.linalg.vector_norm(self.gradient)
        if norm > limit:
            self.gradient.mul_(limit / norm)
        return norm
