"""Interface of vector sources: what a config selects, how labels are looked up and encoded."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, NamedTuple, Protocol

import numpy as np

from knowarm.arrays import Floats
from knowarm.errors import UserError
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.terms import label_of
from knowarm.questions import Condition

Vectors = np.ndarray
"""Numbers of labels, slots or other things: one vector, or one per row."""
Pooling = Literal["mean", "sif"]
OnMissing = Literal["error", "skip", "hash"]
"""What to do with a label of which no word is known: raise an error, leave it out, or give each of
its words a fixed random vector that depends on its letters only."""


class Facet(NamedTuple):
    """What one slot of the scene embedding describes."""

    object: str
    """The object, by its name in the task."""
    colour: str | None
    """The colour, by its name in the task; None describes the object without its colours."""
    colour_number: int | None = None
    """Take the object's colour of this number in place of `colour`: for placebos, whose graph or
    object does not have the true colour."""

    @property
    def name(self) -> str:
        """The slot's name in tables: "red mug", "mug"."""
        if self.colour is None:
            return label_of(self.object, {})
        return label_of(f"{self.colour} {self.object}", {})


class SentencePart(NamedTuple):
    """One label of a sentence."""

    name: str  # The entity's or relation's name in the graph
    label: str  # Its words in lower case, separated by spaces
    is_relation: bool  # Whether it is the label of an edge


@dataclass
class Coverage:
    """How the labels of a scene were found in a vocabulary."""

    # By label: "word", "joined", "words", "form", "alias", "part" (some words only), "hash",
    # "missing", or "entity" for graph embeddings
    how: dict[str, str] = field(default_factory=dict)
    # Words that were not found in any form
    missing: set[str] = field(default_factory=set)

    @property
    def share(self) -> float:
        """Share of the labels of which all words were found, 0 to 1."""
        return 1.0 - len(self._incomplete) / max(len(self.how), 1)

    @property
    def _incomplete(self) -> list[str]:
        incomplete = ("part", "hash", "missing")
        return sorted(label for label, how in self.how.items() if how in incomplete)

    def describe(self) -> dict[str, Any]:
        """Return the report as JSON-able values."""
        by_kind = Counter(sorted(self.how.values()))
        return {
            "share": self.share,
            "labels": len(self.how),
            "by_kind": dict(by_kind),
            "not_whole": self._incomplete,
            "missing_words": sorted(self.missing),
        }


class Found(NamedTuple):
    """The vectors of one label."""

    # One row per word (or one row for an entity), (k, dim) float32; k = 0 if none is known
    vectors: Vectors
    # Frequency of each in text or in the graph, 0 to 1, (k,) float64: for SIF weights
    frequencies: Floats


class VectorLookup(Protocol):
    """An opened source: finds the vectors of labels."""

    name: str
    """Name for messages and reports."""
    dim: int
    """Numbers per vector."""

    def find(self, part: SentencePart, coverage: Coverage) -> Found:
        """Return the vectors of one part of a sentence, and record in `coverage` how."""
        ...


@dataclass(frozen=True, kw_only=True)
class Request:
    """What a source is opened for."""

    graph: KnowledgeGraph
    """The graph, which graph embeddings are trained on."""
    parts: Sequence[SentencePart]
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
class VectorSource:
    """Base of the configs of vector sources; a literal field `kind` tells them apart in files.

    A new source defines `open` and is registered in `knowledge.vectors.SOURCES`. A placebo is a
    source that falsifies one step of the pipeline with a method ``change_...``.
    """

    placebo: ClassVar[bool] = False
    """Whether the numbers carry no meaning, or a false one: a control of an experiment."""
    content_free: ClassVar[bool] = False
    """Whether the numbers depend on how many slots there are and how long, not on what they
    describe: such a control fits every subject with slots of that length."""
    described: ClassVar[bool] = True
    """Whether slots are computed from the graph; else `change_vectors` replaces zeros."""
    note: ClassVar[str] = ""
    """What reports say beside this source."""
    encoder: ClassVar[Literal["identity", "learned"]] = "identity"
    """How the policy reads the numbers: as they are, or through weights that it learns."""

    @property
    def short_name(self) -> str:
        """Name for tables: the kind, or what the source loads."""
        return str(getattr(self, "kind", type(self).__name__))

    @property
    def real(self) -> "VectorSource":
        """The source whose lengths the slots have: itself, or the one that a placebo copies."""
        return self

    def open(self, request: Request) -> VectorLookup:
        """Open the source."""
        raise NotImplementedError

    def draw_seed(self, seed: int, run_seed: int) -> int:
        """Return the seed of what a placebo draws, from the config's and the training run's."""
        return seed

    def change_graph(self, graph: KnowledgeGraph, seed: int) -> KnowledgeGraph:
        """Return the graph that slots are described by."""
        return graph

    def change_facets(
        self,
        facets: Sequence[Facet],
        graph: KnowledgeGraph,
        colour_relation: str,
        seed: int,
    ) -> Sequence[Facet]:
        """Return what the slots of a scene describe, by names of the graph."""
        return facets

    def change_conditions(self, conditions: Sequence[Condition]) -> Sequence[Condition]:
        """Return what the slots of queries describe."""
        return conditions

    def change_vectors(self, vectors: Vectors, seed: int) -> Vectors:
        """Return the slots (S, D) that the policy receives in place of the pooled ones."""
        return vectors


SOURCES: dict[str, type[VectorSource]] = {}
"""Config class of every source by its `kind`; filled by ``knowledge.vectors``."""


@dataclass(frozen=True, kw_only=True)
class SentenceEncoder(VectorSource):
    """One vector per label, from a sentence encoder."""

    kind: Literal["sentence-transformers"] = "sentence-transformers"
    """Tells this source from the others in a file."""
    model: str
    """Path of a model folder, or the name of a model in the local cache."""

    def open(self, request: Request) -> "EncoderLookup":
        """Load the model."""
        return EncoderLookup(self.model)


class EncoderLookup:
    """Encodes labels; none is ever missing, and all have the same SIF weight."""

    def __init__(self, model: str) -> None:
        """Load a model by its path or name."""
        try:
            from sentence_transformers import SentenceTransformer
        except ImportError as error:
            raise UserError(
                "Sentence encoders need the package sentence-transformers. Install it with "
                "`pip install sentence-transformers`, or take the word vectors wordnet-gloss-50."
            ) from error
        try:
            self._encoder = SentenceTransformer(model, device="cpu")
        except (OSError, ValueError) as error:
            reason = (str(error).splitlines() or [type(error).__name__])[0]
            raise UserError(
                f"The sentence encoder {model!r} cannot be loaded: {reason}. Give the path of a "
                f"model folder on this machine."
            ) from error
        self.name = model
        self.dim = int(self._encoder.get_sentence_embedding_dimension())

    def find(self, part: SentencePart, coverage: Coverage) -> Found:
        """Return one vector for the whole label."""
        coverage.how[part.label] = "word"
        vector = self._encoder.encode(
            [part.label], convert_to_numpy=True, show_progress_bar=False
        )
        return Found(np.asarray(vector, np.float32), np.zeros(1))
