"""Interface of vector sources: what a config selects, and how labels are looked up."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, NamedTuple, Protocol

import numpy as np

from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.sentence import Part

OnMissing = Literal["error", "skip", "hash"]
"""What to do with a label of which no word is known: raise an error, leave it out, or give each of
its words a fixed random vector that depends on its letters only."""


@dataclass
class Coverage:
    """How the labels of a scene were found in a vocabulary.

    Attributes:
        how: by label: "word", "joined", "words", "form", "alias", "part" (some words only),
            "hash", "missing", or "entity" for graph embeddings.
        missing: words that were not found in any form.
    """

    how: dict[str, str] = field(default_factory=dict)
    missing: set[str] = field(default_factory=set)

    @property
    def share(self) -> float:
        """Share of the labels of which all words were found, 0 to 1."""
        return 1.0 - len(self._incomplete) / len(self.how) if self.how else 1.0

    @property
    def _incomplete(self) -> list[str]:
        return sorted(
            label for label, kind in self.how.items() if kind in ("part", "hash", "missing")
        )

    def describe(self) -> dict[str, Any]:
        """Return the report as JSON-able values."""
        kinds = sorted(set(self.how.values()))
        return {
            "share": self.share,
            "labels": len(self.how),
            "by_kind": {kind: sum(k == kind for k in self.how.values()) for kind in kinds},
            "not_whole": self._incomplete,
            "missing_words": sorted(self.missing),
        }


class Found(NamedTuple):
    """The vectors of one label."""

    vectors: np.ndarray
    """One row per word (or one row for an entity), (k, dim) float32; k = 0 if none is known."""
    frequencies: np.ndarray
    """Frequency of each in text or in the graph, 0 to 1, (k,) float64: for SIF weights."""


class VectorLookup(Protocol):
    """An opened source: finds the vectors of labels.

    Attributes:
        name: name for messages and reports.
        dim: numbers per vector.
    """

    name: str
    dim: int

    def find(self, part: Part, coverage: Coverage) -> Found:
        """Return the vectors of one part of a sentence, and record in `coverage` how."""
        ...


@dataclass(frozen=True, kw_only=True)
class Request:
    """What a source is opened for."""

    graph: KnowledgeGraph
    """The graph, which graph embeddings are trained on."""
    parts: Sequence[Part]
    """The labels that will be looked up; of a vector file only their words are read."""
    dim: int
    """Numbers per vector that the experiment expects."""
    seed: int = 0
    """Seed of graph embeddings."""
    aliases: Mapping[str, str] = field(default_factory=dict)
    """Other words for labels that the vectors do not know."""
    on_missing: OnMissing = "error"
    """What to do with a label of which no word is known."""


@dataclass(frozen=True, kw_only=True)
class Source:
    """Base of the configs of vector sources; a literal field `kind` tells them apart in files.

    A new source derives from `VectorSource` or `CodeSource` and is registered in
    `knowledge.vectors.SOURCES`.
    """

    placebo: ClassVar[bool] = False
    """Whether the numbers carry no meaning, or a false one: a control of an experiment."""
    content_free: ClassVar[bool] = False
    """Whether the numbers depend on how many slots there are and how long, not on what they
    describe: such a control fits every subject with slots of that length."""
    note: ClassVar[str] = ""
    """What reports say beside this source."""
    encoder: ClassVar[Literal["identity", "learned"]] = "identity"
    """How the policy reads the numbers: as they are, or through weights that it learns."""

    earlier_values: ClassVar[Mapping[str, Any]] = {}
    """Meaning of fields that files of earlier versions lack, where it is not the default."""

    @property
    def short_name(self) -> str:
        """Name for tables: the kind, or what the source loads."""
        return str(getattr(self, "kind", type(self).__name__))


@dataclass(frozen=True, kw_only=True)
class VectorSource(Source, ABC):
    """A source whose slots are pooled from the vectors of labels.

    The methods beside `open` are for placebos, which falsify one step on the way.
    """

    @abstractmethod
    def open(self, request: Request) -> VectorLookup:
        """Open the source.

        Raises:
            UserError: the vectors cannot be loaded.
        """

    def draw_seed(self, seed: int, run_seed: int) -> int:
        """Return the seed of what a placebo draws.

        Args:
            seed: of the knowledge's config.
            run_seed: of the training run.
        """
        del run_seed
        return seed

    def change_graph(self, graph: KnowledgeGraph, seed: int) -> KnowledgeGraph:
        """Return the graph that slots are described by."""
        del seed
        return graph

    def change_slots(self, slots: np.ndarray, seed: int) -> np.ndarray | None:
        """Return other slots (S, D) in place of the pooled ones; None keeps those."""
        del slots, seed
        return None


@dataclass(frozen=True, kw_only=True)
class CodeSource(Source, ABC):
    """A source whose slots depend on their number only, not on the graph."""

    placebo: ClassVar[bool] = True

    @abstractmethod
    def code(self, slots: int, dim: int) -> np.ndarray:
        """Return the slots, (slots, dim) float32."""
