"""TransE (Bordes et al. 2013): heads move by a relation's vector and should land on the tail."""

import torch
from torch import Tensor

from knowarm.knowledge.kge.model import KgeModel, normal


class TransE(KgeModel):
    """score(h, r, t) = -||h + r - t||_1."""

    learning_rate = 0.003
    n3 = 0.0

    def init(
        self, entities: int, relations: int, dim: int, generator: torch.Generator
    ) -> tuple[Tensor, Tensor]:
        """Return small normal vectors."""
        return normal(entities, dim, 0.1, generator), normal(relations, dim, 0.1, generator)

    def query(self, head: Tensor, relation: Tensor) -> Tensor:
        """Return h + r."""
        return head + relation

    def compare(self, query: Tensor, tail: Tensor) -> Tensor:
        """Return the negative distances."""
        return -torch.cdist(query, tail, p=1)
