"""Graph-embedding models: ANALOGY and ComplEx, and what they share."""

from abc import ABC, abstractmethod

import torch
from torch import Generator, Tensor, nn


class KgeModel(nn.Module, ABC):
    """Scores triples (h, r, t): E entities, R relations and their R reciprocals, D numbers each.

    A model turns head and relation into a query and compares it with every tail, so that one
    matrix product answers (h, r, ?). Heads are queried through the reciprocal relation r + R.
    """

    learning_rate = 0.01
    """Adam's step size that suits the model."""
    n3 = 0.03
    """Weight of the N3 penalty that suits the model."""
    divisor = 1
    """Number that `dim` must be divisible by."""

    def __init__(
        self, entities: int, relations: int, dim: int, generator: Generator
    ) -> None:
        super().__init__()
        self.relations = relations
        entity = torch.randn(entities, dim, generator=generator)
        relation = torch.randn(2 * relations, dim, generator=generator)
        self.entity = nn.Parameter(entity * 0.1)
        self.relation = nn.Parameter(relation * 0.1)

    @abstractmethod
    def query(self, head: Tensor, relation: Tensor) -> Tensor:
        """Combine heads (B, D) and relations (B, D) into queries (B, D)."""

    def compare(self, query: Tensor, tail: Tensor) -> Tensor:
        """Score queries (B, D) against tails (E, D) by dot products, (B, E)."""
        return query @ tail.T

    def moduli(self, vectors: Tensor) -> Tensor:
        """Return the absolute values whose cubes N3 sums, of real numbers or complex pairs."""
        return vectors.abs()

    def forward(
        self, head: Tensor, relation: Tensor, tails: Tensor | None = None
    ) -> Tensor:
        """Score tails, by default every entity: ids (B,), (B,), (T,) -> scores (B, T)."""
        compared: Tensor = self.entity
        if tails is not None:
            compared = compared[tails]
        query = self.query(self.entity[head], self.relation[relation])
        return self.compare(query, compared)

    def penalty(self, head: Tensor, relation: Tensor, tail: Tensor) -> Tensor:
        """N3: mean over the batch of sum |h|^3 + |r|^3 + |t|^3 (Lacroix et al. 2018, eq. 3)."""
        batch = (self.entity[head], self.relation[relation], self.entity[tail])
        sums = [self.moduli(vectors).pow(3).sum(dim=1) for vectors in batch]
        return torch.stack(sums).sum(0).mean()


class Analogy(KgeModel):
    """score(h, r, t) = <h_s, r_s, t_s> + Re(<h_c, r_c, conj(t_c)>) (Liu, Wu and Yang 2017).

    The paper's first choice. The relation is a normal matrix that is block diagonal: 1 x 1 blocks
    (scalars, s) and 2 x 2 blocks (complex pairs, c), so any two relations commute. Of D numbers,
    D/4 are complex pairs (rounded down) and the rest scalars, so an entity is exactly D wide:
    scalars, then real parts, then imaginary parts.
    """

    numbers_per_pair = 4
    """Numbers of a vector for each complex pair."""

    def query(self, head: Tensor, relation: Tensor) -> Tensor:
        """Return h r, whose dot product with (t_s, Re t_c, Im t_c) is the score."""
        head_scalars, a, b = self._split(head)
        relation_scalars, c, d = self._split(relation)
        scalars = head_scalars * relation_scalars
        real = a * c - b * d
        imaginary = a * d + b * c
        return torch.cat([scalars, real, imaginary], dim=-1)

    def moduli(self, vectors: Tensor) -> Tensor:
        """Return the absolute scalars and the moduli of the complex pairs, smooth at 0."""
        scalars, a, b = self._split(vectors)
        squares = a * a + b * b + 1e-12
        return torch.cat([scalars.abs(), squares.sqrt()], dim=-1)

    def _split(self, vectors: Tensor) -> tuple[Tensor, ...]:
        """Split (..., D) into scalars, real parts and imaginary parts."""
        dim = vectors.shape[-1]
        pairs = dim // self.numbers_per_pair
        return vectors.split([dim - 2 * pairs, pairs, pairs], dim=-1)


class ComplEx(Analogy):
    """score(h, r, t) = Re(<h, r, conj(t)>) (Trouillon et al. 2016): ANALOGY without scalars.

    Vectors are D/2 complex numbers: real parts, then imaginary parts.
    """

    divisor = 2
    numbers_per_pair = 2


MODELS: dict[str, type[KgeModel]] = {
    "analogy": Analogy,
    "complex": ComplEx,
}
"""Every model by name. A new one is one class like `Analogy` and one line here."""
