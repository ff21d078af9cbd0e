"""What all graph-embedding models share: vectors of entities and relations, scores, a penalty."""

from abc import ABC, abstractmethod
from typing import ClassVar

import torch
from torch import Tensor, nn


class KgeModel(nn.Module, ABC):
    """Scores triples (h, r, t): E entities, R relations and their R reciprocals, D numbers each.

    A model turns head and relation into a query and compares it with every tail, so that one
    matrix product answers (h, r, ?). Heads are asked for through the reciprocal relation r + R.

    Attributes:
        entity: vectors of entities, (E, D).
        relation: vectors of relations and reciprocals, (2 R, D_r).
    """

    learning_rate: ClassVar[float]
    """Adam's step size that suits the model."""
    n3: ClassVar[float]
    """Weight of the N3 penalty that suits the model; 0 for distances, which need none."""
    divisor: ClassVar[int] = 1
    """What `dim` must be divisible by."""

    def __init__(self, entities: int, relations: int, dim: int, generator: torch.Generator) -> None:
        super().__init__()
        self.relations = relations
        entity, relation = self.init(entities, 2 * relations, dim, generator)
        self.entity = nn.Parameter(entity)
        self.relation = nn.Parameter(relation)

    @abstractmethod
    def init(
        self, entities: int, relations: int, dim: int, generator: torch.Generator
    ) -> tuple[Tensor, Tensor]:
        """Return the first vectors of entities (E, D) and relations (relations, D_r)."""

    @abstractmethod
    def query(self, head: Tensor, relation: Tensor) -> Tensor:
        """Combine heads (B, D) and relations (B, D_r) into queries (B, D)."""

    @abstractmethod
    def compare(self, query: Tensor, tail: Tensor) -> Tensor:
        """Score queries (B, D) against tails (E, D); returns (B, E)."""

    def moduli(self, vectors: Tensor) -> Tensor:
        """Return the absolute values that N3 sums the cubes of: of real numbers, themselves."""
        return vectors.abs()

    def relation_vectors(self) -> Tensor:
        """Return one D-wide vector a relation, (2 R, D), for use beside entity vectors."""
        return self.relation

    def forward(self, head: Tensor, relation: Tensor) -> Tensor:
        """Score every tail: ids (B,), (B,) -> scores (B, E)."""
        return self.compare(self.query(self.entity[head], self.relation[relation]), self.entity)

    def score(self, head: Tensor, relation: Tensor, tail: Tensor) -> Tensor:
        """Score single triples: ids (B,) each -> (B,)."""
        query = self.query(self.entity[head], self.relation[relation])
        single = [
            self.compare(q[None], t[None])[0] for q, t in zip(query, self.entity[tail], strict=True)
        ]
        return torch.cat(single)

    def penalty(self, head: Tensor, relation: Tensor, tail: Tensor) -> Tensor:
        """N3: mean over the batch of sum |h|^3 + |r|^3 + |t|^3 (Lacroix et al. 2018, eq. 3)."""
        vectors = (self.entity[head], self.relation[relation], self.entity[tail])
        return torch.stack([self.moduli(v).pow(3).sum(dim=1) for v in vectors]).sum(0).mean()


def normal(rows: int, columns: int, scale: float, generator: torch.Generator) -> Tensor:
    """Return normal noise (rows, columns) of a given standard deviation."""
    return torch.randn(rows, columns, generator=generator) * scale


def real_and_imaginary(vectors: Tensor) -> tuple[Tensor, Tensor]:
    """Split (..., D) into real and imaginary halves, (..., D/2) each."""
    half = vectors.shape[-1] // 2
    return vectors[..., :half], vectors[..., half:]
