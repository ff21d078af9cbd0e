"""RotatE (Sun et al. 2019): a relation turns each complex number of the head by its own angle."""

import torch
from torch import Tensor

from knowarm.knowledge.kge.model import KgeModel, normal, real_and_imaginary


class RotatE(KgeModel):
    """score(h, r, t) = -sum_i |h_i exp(i phase_i) - t_i|, D/2 complex numbers, D/2 phases."""

    learning_rate = 0.003
    n3 = 0.0
    divisor = 2

    def init(
        self, entities: int, relations: int, dim: int, generator: torch.Generator
    ) -> tuple[Tensor, Tensor]:
        """Return small normal entities and phases spread over the circle [rad]."""
        phases = (torch.rand(relations, dim // 2, generator=generator) * 2 - 1) * torch.pi
        return normal(entities, dim, 0.1, generator), phases

    def query(self, head: Tensor, relation: Tensor) -> Tensor:
        """Return the turned head."""
        a, b = real_and_imaginary(head)
        cos, sin = relation.cos(), relation.sin()
        return torch.cat([a * cos - b * sin, a * sin + b * cos], dim=-1)

    def compare(self, query: Tensor, tail: Tensor) -> Tensor:
        """Return the negative distances, summed over moduli."""
        plane_query, plane_tail = _planes(query), _planes(tail)
        return -torch.cdist(plane_query, plane_tail).sum(dim=0)

    def relation_vectors(self) -> Tensor:
        """Return cosines and sines of the phases, (2 R, D)."""
        return torch.cat([self.relation.cos(), self.relation.sin()], dim=-1)


def _planes(vectors: Tensor) -> Tensor:
    """Return each complex number as a point of its own plane, (n, D) -> (D/2, n, 2)."""
    return torch.stack(real_and_imaginary(vectors), dim=-1).transpose(0, 1).contiguous()
