"""ComplEx (Trouillon et al. 2016): complex heads and relations go in, queries come out."""

import torch
from torch import Tensor

from knowarm.knowledge.kge.model import KgeModel, normal, real_and_imaginary


class ComplEx(KgeModel):
    """score(h, r, t) = Re(<h, r, conj(t)>), D/2 complex numbers: real half, imaginary half."""

    learning_rate = 0.01
    n3 = 0.03
    divisor = 2

    def init(
        self, entities: int, relations: int, dim: int, generator: torch.Generator
    ) -> tuple[Tensor, Tensor]:
        """Return small normal vectors."""
        return normal(entities, dim, 0.1, generator), normal(relations, dim, 0.1, generator)

    def query(self, head: Tensor, relation: Tensor) -> Tensor:
        """Return h r, whose dot product with (Re t, Im t) is Re(h r conj(t))."""
        a, b = real_and_imaginary(head)
        c, d = real_and_imaginary(relation)
        return torch.cat([a * c - b * d, a * d + b * c], dim=-1)

    def compare(self, query: Tensor, tail: Tensor) -> Tensor:
        """Return the dot products."""
        return query @ tail.T

    def moduli(self, vectors: Tensor) -> Tensor:
        """Return the moduli of the complex numbers."""
        a, b = real_and_imaginary(vectors)
        return (a * a + b * b + 1e-12).sqrt()
