"""Grounding network: finds in an image the place of the object that a query means.

Each place of the image gets a key, the knowledge of a query becomes a vector of the same width,
and the place whose key is most similar is where the object that is meant stands.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from knowarm.config import check_numbers
from knowarm.errors import UserError
from knowarm.experiment.perception import Perception, Seen, seen_of
from knowarm.policy.encoder import RELU_GAIN, orthogonal
from knowarm.seeding import torch_generator

STRIDE = 8
"""Distance of two places in the image [px]."""

WIDTH = 64
"""Dimensions in which places and queries are compared."""


@dataclass(frozen=True, kw_only=True)
class GroundingConfig:
    """How a grounding network is trained; its labels come from the simulator.

    Raises:
        UserError: a number out of its range.
    """

    images: int = 60_000
    """Training images: first images of episodes."""

    epochs: int = 10
    """Passes over the training images."""

    batch: int = 128
    """Images per gradient step."""

    learning_rate: float = 2e-3
    """Largest learning rate of Adam; it rises and falls once (one cycle)."""

    naming_coef: float = 0.5
    """Weight of a second loss that names the visible objects and their colours."""

    def __post_init__(self) -> None:
        check_numbers(self)
        for name in ("images", "epochs", "batch"):
            if getattr(self, name) < 1:
                raise UserError(f"grounding.{name} must be at least 1, got {getattr(self, name)}.")
        if not self.learning_rate > 0:
            raise UserError(f"grounding.learning_rate must be above 0, got {self.learning_rate}.")
        if not self.naming_coef >= 0:
            raise UserError(f"grounding.naming_coef must be 0 or more, got {self.naming_coef}.")


class Grounding(Perception):
    """Perception network whose places also have keys to compare with a query.

    Args:
        seen: what the images show.
        knowledge: (Q, K) float32, one row per query.
        slots: number of equal parts of a row, one per condition; a part of zeros is none.
        seed: of the initial weights.

    Attributes:
        knowledge: (Q, K) buffer; may be replaced by a table of other queries.
    """

    FORMAT: ClassVar[str] = "knowarm-grounding-1"

    knowledge: Tensor

    def __init__(
        self, seen: Seen, knowledge: np.ndarray | Tensor, slots: int, *, seed: int = 0
    ) -> None:
        super().__init__(seen, seed=seed)
        self.slots = slots
        self.register_buffer("knowledge", torch.as_tensor(knowledge, dtype=torch.float32).clone())
        channels, hidden = self.objects.in_channels, 2 * WIDTH
        width = self.knowledge.shape[1] // slots
        self.key = nn.Sequential(
            nn.Linear(channels, hidden), nn.ReLU(), nn.Linear(hidden, WIDTH)
        )  # fmt: skip
        self.query = nn.Sequential(
            nn.Linear(width, hidden), nn.ReLU(), nn.Linear(hidden, WIDTH)
        )  # fmt: skip
        if not self.objects.weight.is_meta:
            generator = torch_generator(seed, "perception", 1)
            for layer in (*self.key, *self.query):
                orthogonal(layer, RELU_GAIN, generator)

    def describe(self) -> dict[str, Any]:
        """As `Perception.describe`."""
        return super().describe() | {"slots": self.slots}

    @classmethod
    def build(cls, about: dict[str, Any], tensors: Mapping[str, Tensor]) -> "Grounding":
        """As `Perception.build`."""
        table, slots = tensors["knowledge"], about["slots"]
        if table.ndim != 2 or not isinstance(slots, int) or slots < 1 or table.shape[1] % slots:
            raise ValueError("its table of knowledge does not fit its slots")
        return cls(seen_of(about), table, slots)

    def keys(self, features: Tensor) -> Tensor:
        """Compute the keys of P places from `features`: (n, P, D)."""
        keys: Tensor = self.key(features.flatten(2).transpose(1, 2))
        return keys

    def wanted(self, knowledge: Tensor) -> Tensor:
        """Compute what keys are compared with, for queries (Q, K): (Q, D)."""
        slots = knowledge.unflatten(1, (self.slots, -1))
        used = (slots != 0).any(2, keepdim=True)
        return (self.query(slots) * used).sum(1) / WIDTH**0.5

    def places(self, images: Tensor, queries: Tensor) -> Tensor:
        """Find what queries mean.

        Args:
            images: (n, H, W, 3) uint8.
            queries: (n,) int64, rows of the knowledge table.

        Returns:
            (n,) int64: number of the place, row by row.
        """
        wanted = self.wanted(self.knowledge[queries])
        return (self.keys(self.features(images)) * wanted[:, None]).sum(2).argmax(1)


def places_per_row(image_size: int) -> int:
    """Return the number of places in a row of the image."""
    return -(-image_size // STRIDE)


def place_of(pixel: Tensor, image_size: int) -> Tensor:
    """Return the place (...) int64 of image points (..., 2), column and row [px]."""
    side = places_per_row(image_size)
    column, row = (pixel / STRIDE).long().clamp(0, side - 1).unbind(-1)
    return row * side + column


def centres(image_size: int) -> Tensor:
    """Return column and row of the centre of every place, (P, 2) float32 [px]."""
    line = (torch.arange(places_per_row(image_size)) + 0.5) * STRIDE
    row, column = torch.meshgrid(line, line, indexing="ij")
    return torch.stack((column.flatten(), row.flatten()), dim=1)


def place_table(image_size: int) -> np.ndarray:
    """Return what a policy is told about each place, (P, 2) float32.

    Column and row of the place, standardized over all places.
    """
    points = centres(image_size).numpy()
    return ((points - points.mean(0)) / points.std(0)).astype(np.float32)
