"""The one door: a part of a sentence goes in, its vectors and their frequencies come out."""

from typing import NamedTuple, Protocol

import numpy as np

from knowarm.knowledge.sentence import Part
from knowarm.knowledge.vectors.coverage import Coverage


class Found(NamedTuple):
    """The vectors of one label."""

    vectors: np.ndarray
    """One row a word (or one row for an entity), (k, dim) float32; k = 0 when nothing is known."""
    frequencies: np.ndarray
    """How common each is, 0 to 1, (k,) float64: what SIF weights by."""


class VectorSource(Protocol):
    """Word vectors, graph embeddings and sentence encoders all look like this."""

    name: str
    dim: int

    def find(self, part: Part, coverage: Coverage) -> Found:
        """Return the vectors of one part of a sentence and note in `coverage` how it was found."""
        ...
