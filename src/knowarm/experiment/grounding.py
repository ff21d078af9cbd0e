"""Grounding network: finds in an image the object that a query means, and how to grasp it.

Each place of the image gets a key, the knowledge of a query becomes a vector of the same width,
and the place whose key is most similar is where the object that is meant stands. From the features
of that place the network predicts the object's grasp frame, which the policy is told.
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

STRIDE = 4
"""Distance of two places in the image [px]."""

WIDTH = 64
"""Dimensions in which places and queries are compared."""

FRAME = 9
"""Numbers that describe a grasp frame: standardized position, x and z axis."""


@dataclass(frozen=True, kw_only=True)
class GroundingConfig:
    """How a grounding network is trained; its labels come from the simulator.

    Raises:
        UserError: a number out of its range.
    """

    images: int = 16_000
    """Training images per round: first images of episodes, never the same."""

    rounds: int = 20
    """Number of times that images are drawn and each is trained on once."""

    batch: int = 128
    """Images per gradient step."""

    learning_rate: float = 2e-3
    """Largest learning rate of Adam; it rises and falls once (one cycle)."""

    naming_coef: float = 0.5
    """Weight of a second loss that names the visible objects and their colours."""

    frame_coef: float = 10.0
    """Weight of the squared error of the grasp frames of all visible objects."""

    def __post_init__(self) -> None:
        check_numbers(self)
        for name in ("images", "rounds", "batch"):
            if getattr(self, name) < 1:
                raise UserError(f"grounding.{name} must be at least 1, got {getattr(self, name)}.")
        if not self.learning_rate > 0:
            raise UserError(f"grounding.learning_rate must be above 0, got {self.learning_rate}.")
        for name in ("naming_coef", "frame_coef"):
            if not getattr(self, name) >= 0:
                raise UserError(f"grounding.{name} must be 0 or more, got {getattr(self, name)}.")


class Grounding(Perception):
    """Perception network whose places also have keys to compare with a query, and grasp frames.

    Args:
        seen: what the images show.
        knowledge: (Q, K) float32, one row per query.
        slots: number of equal parts of a row, one per condition; a part of zeros is none.
        seed: of the initial weights.

    Attributes:
        knowledge: (Q, K) buffer; may be replaced by a table of other queries.
        position_mean: (3,) buffer, mean of the grasp positions in training [m].
        position_std: (3,) buffer, their standard deviation [m].
    """

    FORMAT: ClassVar[str] = "knowarm-grounding-2"

    # Places are closer together than those of perception: objects stand 5 mm apart or more.
    CONVOLUTIONS: ClassVar = ((3, 16, 5, 2), (16, 32, 3, 2), (32, 64, 3, 1), (64, 64, 3, 1))

    knowledge: Tensor
    position_mean: Tensor
    position_std: Tensor

    def __init__(
        self, seen: Seen, knowledge: np.ndarray | Tensor, slots: int, *, seed: int = 0
    ) -> None:
        super().__init__(seen, seed=seed)
        self.slots = slots
        self.register_buffer("knowledge", torch.as_tensor(knowledge, dtype=torch.float32).clone())
        self.register_buffer("position_mean", torch.zeros(3))
        self.register_buffer("position_std", torch.ones(3))
        channels, hidden = self.objects.in_channels, 2 * WIDTH
        width = self.knowledge.shape[1] // slots
        self.key = nn.Sequential(
            nn.Linear(channels, hidden), nn.ReLU(), nn.Linear(hidden, WIDTH)
        )  # fmt: skip
        self.query = nn.Sequential(
            nn.Linear(width, hidden), nn.ReLU(), nn.Linear(hidden, WIDTH)
        )  # fmt: skip
        self.frame = nn.Sequential(
            nn.Linear(channels + 2, hidden), nn.ReLU(), nn.Linear(hidden, FRAME)
        )  # fmt: skip
        if not self.objects.weight.is_meta:
            generator = torch_generator(seed, "perception", 1)
            for layer in (*self.key, *self.query, *self.frame):
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
        """Compute what keys are compared with, for queries (Q, K): (Q, D).

        A slot of zeros is no condition; of a query without any, the first counts.
        """
        slots = knowledge.unflatten(1, (self.slots, -1))
        used = (slots != 0).any(2, keepdim=True)
        used[:, 0] |= ~used.any(1)
        return (self.query(slots) * used).sum(1) / WIDTH**0.5

    def frames(self, features: Tensor, places: Tensor) -> Tensor:
        """Predict the grasp frames of the objects that stand at m places of each image.

        Args:
            features: (n, C, h, w), see `features`.
            places: (n, m) int64, numbers of places, row by row.

        Returns:
            (n, m, 9) float32: position, less its mean, over its standard deviation; x and z axis.
        """
        index = places[:, None].expand(-1, features.shape[1], -1)
        found = features.flatten(2).gather(2, index).transpose(1, 2)
        where = centres(self.seen.image_size).to(found) / (self.seen.image_size / 2) - 1
        frames: Tensor = self.frame(torch.cat((found, where[places]), 2))
        return frames

    def standardize(self, positions: Tensor) -> None:
        """Take mean and deviation of grasp positions (..., 3) [m] for `standardized`."""
        self.position_mean, self.position_std = (
            positions.flatten(0, -2).mean(0),
            positions.flatten(0, -2).std(0).clamp(min=1e-3),
        )

    def standardized(self, positions: Tensor) -> Tensor:
        """Standardize grasp positions (..., 3) [m]."""
        return (positions - self.position_mean) / self.position_std

    def found(self, images: Tensor, queries: Tensor) -> Tensor:
        """Predict the grasp frame of what queries mean.

        Args:
            images: (n, H, W, 3) uint8.
            queries: (n,) int64, rows of the knowledge table.

        Returns:
            (n, 9) float32, see `frames`.
        """
        features = self.features(images)
        wanted = self.wanted(self.knowledge[queries])
        place = (self.keys(features) * wanted[:, None]).sum(2).argmax(1)
        return self.frames(features, place[:, None])[:, 0]


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
