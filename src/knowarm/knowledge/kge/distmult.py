"""DistMult (Yang et al. 2015): heads and relations go in, queries for a dot product come out."""

import torch
from torch import Tensor

from knowarm.knowledge.kge.model import KgeModel, normal


class DistMult(KgeModel):
    """score(h, r, t) = <h, r, t> = sum_i h_i r_i t_i."""

    learning_rate = 0.01
    n3 = 0.03

    def init(
        self, entities: int, relations: int, dim: int, generator: torch.Generator
    ) -> tuple[Tensor, Tensor]:
        """Return small normal vectors."""
        return normal(entities, dim, 0.1, generator), normal(relations, dim, 0.1, generator)

    def query(self, head: Tensor, relation: Tensor) -> Tensor:
        """Return h * r."""
        return head * relation

    def compare(self, query: Tensor, tail: Tensor) -> Tensor:
        """Return the dot products."""
        return query @ tail.T
