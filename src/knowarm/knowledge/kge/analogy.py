"""ANALOGY (Liu, Wu and Yang 2017), the paper's first choice: part real, part complex, one score."""

import torch
from torch import Tensor

from knowarm.knowledge.kge.model import KgeModel, normal, real_and_imaginary


class Analogy(KgeModel):
    """score(h, r, t) = <h_s, r_s, t_s> + Re(<h_c, r_c, conj(t_c)>).

    The relation is a normal matrix that is block diagonal: 1 x 1 blocks (scalars, s) and 2 x 2
    blocks (complex pairs, c), so any two relations commute. Of D numbers, D/4 are complex pairs
    (rounded down) and the rest scalars, so that an entity is exactly D wide.
    """

    learning_rate = 0.01
    n3 = 0.03

    def init(
        self, entities: int, relations: int, dim: int, generator: torch.Generator
    ) -> tuple[Tensor, Tensor]:
        """Return small normal vectors."""
        return normal(entities, dim, 0.1, generator), normal(relations, dim, 0.1, generator)

    def query(self, head: Tensor, relation: Tensor) -> Tensor:
        """Return the head times the relation's block diagonal matrix."""
        scalars = _scalars(head)
        a, b = real_and_imaginary(head[..., scalars:])
        c, d = real_and_imaginary(relation[..., scalars:])
        real = head[..., :scalars] * relation[..., :scalars]
        return torch.cat([real, a * c - b * d, a * d + b * c], dim=-1)

    def compare(self, query: Tensor, tail: Tensor) -> Tensor:
        """Return the dot products."""
        return query @ tail.T

    def moduli(self, vectors: Tensor) -> Tensor:
        """Return the absolute scalars and the moduli of the complex pairs."""
        scalars = _scalars(vectors)
        a, b = real_and_imaginary(vectors[..., scalars:])
        return torch.cat([vectors[..., :scalars].abs(), (a * a + b * b + 1e-12).sqrt()], dim=-1)


def _scalars(vectors: Tensor) -> int:
    """Return how many of the D numbers are scalars."""
    dim = vectors.shape[-1]
    return dim - 2 * (dim // 4)
