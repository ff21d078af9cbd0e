"""A table of words and their vectors: what every word-vector file becomes."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np


@dataclass(frozen=True, kw_only=True)
class WordVectors:
    """Words with their vectors and their frequency ranks."""

    name: str
    """What they are called in a report: a shipped name or a file's path."""
    words: tuple[str, ...]
    """The words held here; of a file, only those that were asked for."""
    vectors: np.ndarray = field(repr=False)
    """One row a word, (n, dim) float32."""
    ranks: np.ndarray = field(repr=False)
    """Place of each word in the file, 1 = most frequent, (n,) int64."""
    size: int
    """Number of words in the whole file."""

    @property
    def dim(self) -> int:
        """Numbers a word."""
        return int(self.vectors.shape[1])

    @cached_property
    def index(self) -> dict[str, int]:
        """Row by word."""
        return {word: row for row, word in enumerate(self.words)}

    @cached_property
    def frequencies(self) -> np.ndarray:
        """Share of running text that each word takes, (n,) float64.

        Zipf's law, p(rank) = 1 / (rank * H(size)): a vector file gives the order of words only.
        """
        harmonic = np.log(self.size) + 0.5772156649
        return 1.0 / (self.ranks * harmonic)
