"""Placebos: slots of the real shape that carry no meaning, or a false one."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np

from knowarm.config import registered
from knowarm.errors import UserError
from knowarm.knowledge.graph.builder import shuffle_tails
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.vectors.source import (
    SOURCES,
    Facet,
    Request,
    VectorLookup,
    Vectors,
    VectorSource,
)
from knowarm.knowledge.vectors.words import WordVectors
from knowarm.questions import Condition
from knowarm.seeding import derive_seed


@dataclass(frozen=True, kw_only=True)
class Zeros(VectorSource):
    """Zeros: the network's shape without any input."""

    kind: Literal["zeros"] = "zeros"
    placebo: ClassVar[bool] = True
    described: ClassVar[bool] = False
    note: ClassVar[str] = "placebo: zeros, the network's shape without knowledge"


@dataclass(frozen=True, kw_only=True)
class Learned(VectorSource):
    """The slot's number as a one-hot, for a policy that learns the vectors itself."""

    kind: Literal["learned"] = "learned"
    placebo: ClassVar[bool] = True
    described: ClassVar[bool] = False
    note: ClassVar[str] = (
        "one-hot slot numbers; the policy learns the vectors (encoder 'learned')"
    )
    encoder: ClassVar[Literal["identity", "learned"]] = "learned"

    def change_vectors(self, vectors: Vectors, seed: int) -> Vectors:
        """Return rows of the identity matrix."""
        return _one_hot(*vectors.shape)


@dataclass(frozen=True, kw_only=True)
class Placebo(VectorSource):
    """Base of the placebos that copy shape and norm of a real source."""

    placebo: ClassVar[bool] = True
    matches: VectorSource = field(
        default_factory=WordVectors,
        metadata=registered(
            lambda: [cls for cls in SOURCES.values() if not cls.placebo]
        ),
    )
    """The real source."""

    def __post_init__(self) -> None:
        if self.matches.placebo:
            raise UserError(
                f"matches must be a real source, got the placebo {self.matches}."
            )

    @property
    def real(self) -> VectorSource:
        """The source that it copies."""
        return self.matches

    def open(self, request: Request) -> VectorLookup:
        """Open the real source."""
        return self.matches.open(request)


@dataclass(frozen=True, kw_only=True)
class DrawnPlacebo(Placebo):
    """Base of the placebos that draw random numbers.

    Each training seed gives another placebo, so training seeds sample the control.
    """

    def draw_seed(self, seed: int, run_seed: int) -> int:
        """Derive the seed of a draw from the run's seed and the knowledge's."""
        return derive_seed(run_seed, "placebos", seed, 0)


@dataclass(frozen=True, kw_only=True)
class RandomVectors(DrawnPlacebo):
    """Normal noise, each slot as long as the real one."""

    kind: Literal["random"] = "random"
    content_free: ClassVar[bool] = True
    note: ClassVar[str] = "placebo: random numbers, each slot as long as the real one"

    def change_vectors(self, vectors: Vectors, seed: int) -> Vectors:
        """Return noise scaled to the length of each slot."""
        noise = np.random.default_rng(seed).standard_normal(vectors.shape)
        length = np.linalg.norm(vectors, axis=1, keepdims=True)
        return (noise * (length / np.linalg.norm(noise, axis=1, keepdims=True))).astype(
            np.float32
        )


@dataclass(frozen=True, kw_only=True)
class OneHot(Placebo):
    """The slot's number as a one-hot, as long as the real slot: identity without meaning."""

    kind: Literal["onehot"] = "onehot"
    content_free: ClassVar[bool] = True
    note: ClassVar[str] = (
        "placebo: one-hot slot numbers, as long as the real slots; identity without meaning"
    )

    def change_vectors(self, vectors: Vectors, seed: int) -> Vectors:
        """Return the length of each slot at the place of its number."""
        return _one_hot(*vectors.shape) * np.linalg.norm(vectors, axis=1)[:, None]


@dataclass(frozen=True, kw_only=True)
class ShuffledGraph(DrawnPlacebo):
    """Real vectors of a graph whose tails are permuted within each relation."""

    kind: Literal["shuffled"] = "shuffled"
    note: ClassVar[str] = "placebo: the graph's tails are permuted within each relation"

    def change_graph(self, graph: KnowledgeGraph, seed: int) -> KnowledgeGraph:
        """Permute the tails."""
        return shuffle_tails(graph, seed)

    def change_facets(
        self,
        facets: Sequence[Facet],
        graph: KnowledgeGraph,
        colour_relation: str,
        seed: int,
    ) -> Sequence[Facet]:
        """Take each object's colours in the order of the shuffled graph."""
        return _number_colours(facets)


@dataclass(frozen=True, kw_only=True)
class WrongObject(DrawnPlacebo):
    """Real vectors of other objects: each object is replaced by one of the graph."""

    kind: Literal["wrong-object"] = "wrong-object"
    note: ClassVar[str] = "placebo: every slot describes another object than its own"

    def change_facets(
        self,
        facets: Sequence[Facet],
        graph: KnowledgeGraph,
        colour_relation: str,
        seed: int,
    ) -> Sequence[Facet]:
        """Replace each object by another one of the graph with as many colours."""
        task_objects = list(dict.fromkeys(facet.object for facet in facets))
        colours_per_object = Counter(facet.object for facet in facets)
        needed = max(colours_per_object.values())
        in_task = [graph.entity_id(name) for name in task_objects]
        relation = graph.relation_id(colour_relation)
        heads, colours = np.unique(
            graph.heads[graph.relations == relation], return_counts=True
        )
        others = np.setdiff1d(heads[colours >= needed], in_task)
        if len(others) < len(task_objects):
            raise UserError(
                f"The placebo 'wrong-object' needs {len(task_objects)} other objects with {needed} "
                f"colours in the graph, which has {len(others)}. Take another placebo, e.g. "
                "'shuffled'."
            )
        rng = np.random.default_rng(seed)
        drawn = rng.choice(others, len(task_objects), replace=False)
        wrong = dict(zip(task_objects, graph.names.at(drawn), strict=True))
        return _number_colours(
            [facet._replace(object=wrong[facet.object]) for facet in facets]
        )

    def change_conditions(self, conditions: Sequence[Condition]) -> Sequence[Condition]:
        """Refuse queries."""
        raise UserError(
            "The placebo 'wrong-object' describes other objects, and a query has none. Take "
            "another placebo, such as 'shuffled'."
        )


def _number_colours(facets: Sequence[Facet]) -> list[Facet]:
    """Number the colours of each object in the order of its facets."""
    numbered = []
    colours = Counter[str]()
    for facet in facets:
        numbered.append(facet._replace(colour_number=colours[facet.object]))
        colours[facet.object] += 1
    return numbered


def _one_hot(slots: int, dim: int) -> Vectors:
    """Return rows of the identity matrix (S, D); refuse a code that is too short."""
    if slots > dim:
        raise UserError(
            f"{slots} slots do not fit a one-hot of {dim} numbers. Set dim to {slots} or more."
        )
    return np.eye(slots, dim, dtype=np.float32)
