"""Placebos: slots of the real shape that carry no meaning, or a false one."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import numpy as np

from knowarm.config import registered
from knowarm.errors import UserError
from knowarm.knowledge.builder import shuffle_tails
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.vectors.source import CodeSource, Request, VectorLookup, VectorSource
from knowarm.knowledge.vectors.words import WordVectors
from knowarm.seeding import derive_seed


@dataclass(frozen=True, kw_only=True)
class Zeros(CodeSource):
    """Zeros: the network's shape without any input."""

    kind: Literal["zeros"] = "zeros"
    note: ClassVar[str] = "placebo: zeros, the network's shape without knowledge"

    def code(self, slots: int, dim: int) -> np.ndarray:
        """Return zeros."""
        return np.zeros((slots, dim), np.float32)


@dataclass(frozen=True, kw_only=True)
class Learned(CodeSource):
    """The slot's number as a one-hot, for a policy that learns the vectors itself."""

    kind: Literal["learned"] = "learned"
    note: ClassVar[str] = "one-hot slot numbers; the policy learns the vectors (encoder 'learned')"
    encoder: ClassVar[Literal["identity", "learned"]] = "learned"

    def code(self, slots: int, dim: int) -> np.ndarray:
        """Return rows of the identity matrix."""
        check_one_hot(slots, dim)
        return np.eye(slots, dim, dtype=np.float32)


@dataclass(frozen=True, kw_only=True)
class Placebo(VectorSource):
    """Base of the placebos that copy shape and norm of a real source."""

    placebo: ClassVar[bool] = True
    matches: VectorSource = field(
        default_factory=WordVectors, metadata=registered(lambda: _real_sources())
    )
    """The real source."""

    def __post_init__(self) -> None:
        if not isinstance(self.matches, VectorSource) or self.matches.placebo:
            raise UserError(f"matches must be a real source, got the placebo {self.matches}.")

    def open(self, request: Request) -> VectorLookup:
        """Open the real source."""
        return self.matches.open(request)


@dataclass(frozen=True, kw_only=True)
class DrawnPlacebo(Placebo):
    """Base of the placebos that draw random numbers, by default once per training seed."""

    earlier_values: ClassVar[Mapping[str, Any]] = {"draw": None}
    draw: int | None = 0
    """Number of the draw. Each training seed and each number gives another placebo, so training
    seeds sample the control. None gives all training seeds the same one, drawn from the
    knowledge's seed, as in runs of earlier versions."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.draw is not None and self.draw < 0:
            raise UserError(f"draw must be 0 or more, or None, got {self.draw}.")

    def draw_seed(self, seed: int, run_seed: int) -> int:
        """Derive the seed of a draw from the run's seed, the knowledge's and the draw's number."""
        return seed if self.draw is None else derive_seed(run_seed, "placebos", seed, self.draw)


@dataclass(frozen=True, kw_only=True)
class RandomVectors(DrawnPlacebo):
    """Normal noise, each slot as long as the real one."""

    kind: Literal["random"] = "random"
    content_free: ClassVar[bool] = True
    note: ClassVar[str] = "placebo: random numbers, each slot as long as the real one"

    def change_slots(self, slots: np.ndarray, seed: int) -> np.ndarray:
        """Return noise scaled to the length of each slot."""
        noise = np.random.default_rng(seed).standard_normal(slots.shape)
        length = np.linalg.norm(slots, axis=1, keepdims=True)
        return (noise * (length / np.linalg.norm(noise, axis=1, keepdims=True))).astype(np.float32)


@dataclass(frozen=True, kw_only=True)
class OneHot(Placebo):
    """The slot's number as a one-hot, as long as the real slot: identity without meaning."""

    kind: Literal["onehot"] = "onehot"
    content_free: ClassVar[bool] = True
    note: ClassVar[str] = (
        "placebo: one-hot slot numbers, as long as the real slots; identity without meaning"
    )

    def change_slots(self, slots: np.ndarray, seed: int) -> np.ndarray:
        """Return the length of each slot at the place of its number."""
        del seed
        check_one_hot(*slots.shape)
        hot = np.zeros_like(slots)
        places = np.arange(len(slots))
        hot[places, places] = np.linalg.norm(slots, axis=1)
        return hot


@dataclass(frozen=True, kw_only=True)
class ShuffledGraph(DrawnPlacebo):
    """Real vectors of a graph whose tails are permuted within each relation."""

    kind: Literal["shuffled"] = "shuffled"
    note: ClassVar[str] = "placebo: the graph's tails are permuted within each relation"

    def change_graph(self, graph: KnowledgeGraph, seed: int) -> KnowledgeGraph:
        """Permute the tails."""
        return shuffle_tails(graph, seed)


@dataclass(frozen=True, kw_only=True)
class WrongObject(DrawnPlacebo):
    """Real vectors of other objects: `scene.slot_subgraphs` replaces each by one of the graph."""

    kind: Literal["wrong-object"] = "wrong-object"
    note: ClassVar[str] = "placebo: every slot describes another object than its own"


def check_one_hot(slots: int, dim: int) -> None:
    """Refuse a one-hot code that is too short.

    Raises:
        UserError: there are more slots than numbers.
    """
    if slots > dim:
        raise UserError(
            f"{slots} slots do not fit a one-hot of {dim} numbers. Set dim to {slots} or more."
        )


def _real_sources() -> list[type[VectorSource]]:
    """Return the registered sources that a placebo can copy."""
    from knowarm.knowledge.vectors import SOURCES  # the registry imports this module

    return [cls for cls in SOURCES.values() if issubclass(cls, VectorSource) and not cls.placebo]
