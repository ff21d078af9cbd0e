"""A graph, vectors and the task's (object, colour) pairs go in; what the policy is given comes out.

graph -> Gamma -> sentence -> vectors -> one slot a facet -> slots side by side
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from knowarm.errors import UserError
from knowarm.knowledge.config import KnowledgeConfig, Scope
from knowarm.knowledge.facets import Facet, slots_of
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.labels import label_of
from knowarm.knowledge.pooling import slot_vector
from knowarm.knowledge.scene import Facets, load_graph, slot_subgraphs
from knowarm.knowledge.sentence import Part, sentence_parts
from knowarm.knowledge.vectors.coverage import Coverage
from knowarm.knowledge.vectors.open import centre_of, graph_parts, open_source
from knowarm.knowledge.vectors.placebos import SLOT_PLACEBOS


@dataclass(frozen=True, kw_only=True)
class SceneEmbedding:
    """Named slots of numbers, and how they came about."""

    config: KnowledgeConfig
    """What was asked for."""
    slots: tuple[Facet, ...]
    """What each slot describes; empty for detail "none"."""
    matrix: np.ndarray = field(repr=False)
    """The slots' vectors, (S, slot_dim) float32."""
    coverage: Coverage = field(repr=False)
    """How the labels were found."""
    sentences: tuple[str, ...] = field(repr=False)
    """The sentence of each slot; empty strings where a placebo has none."""
    note: str = ""
    """What a reader must know about this input; empty for most."""

    @property
    def scope(self) -> Scope:
        """Whether the policy gets all slots or the episode's own."""
        return self.config.scope

    @property
    def slot_dim(self) -> int:
        """Numbers a slot."""
        return int(self.matrix.shape[1])

    @property
    def vector(self) -> np.ndarray:
        """All slots side by side, (S * slot_dim,) float32."""
        return self.matrix.reshape(-1)

    @property
    def dim(self) -> int:
        """K: numbers that the policy gets, S * slot_dim (scene) or slot_dim (target)."""
        if not self.slots:
            return 0
        return self.slot_dim if self.scope == "target" else self.matrix.size

    @property
    def norm(self) -> float:
        """Euclidean length of the vector."""
        return float(np.linalg.norm(self.vector.astype(np.float64)))

    @property
    def constant(self) -> bool:
        """Whether every episode gets the same numbers, so that they act as a bias only."""
        return self.dim > 0 and (self.scope == "scene" or len(self.slots) == 1)

    @property
    def privileged(self) -> bool:
        """Whether the numbers tell the episode's object, which no camera told."""
        return self.dim > 0 and self.scope == "target"

    def table(self, facets: Facets) -> np.ndarray:
        """Return what the policy gets in an episode of each facet, (F, K) float32.

        Raises:
            UserError: a facet has no slot (scope "target" only).
        """
        if not self.slots:
            return np.zeros((len(facets), 0), np.float32)
        if self.scope == "scene":
            return np.tile(self.vector, (len(facets), 1))
        return np.ascontiguousarray(self.matrix[[self._slot(*facet) for facet in facets]])

    def _slot(self, name: str, colour: str) -> int:
        wanted = Facet(name, None if self.config.detail == "partial" else colour)
        if wanted not in self.slots:
            known = ", ".join(slot.name for slot in self.slots)
            raise UserError(f"No slot describes {wanted.name!r}. The slots are: {known}.")
        return self.slots.index(wanted)

    def describe(self) -> dict[str, Any]:
        """Return all that a run folder keeps about its knowledge, JSON-able."""
        return {
            "config": asdict(self.config),
            "slots": [slot.name for slot in self.slots],
            "slot_dim": self.slot_dim,
            "dim": self.dim,
            "norm": self.norm,
            "slot_norms": np.linalg.norm(self.matrix.astype(np.float64), axis=1).tolist(),
            "coverage": self.coverage.describe(),
            "sentences": dict(zip((s.name for s in self.slots), self.sentences, strict=True)),
            "constant": self.constant,
            "privileged": self.privileged,
            "note": self.note,
        }


def scene_embedding(config: KnowledgeConfig, facets: Facets) -> SceneEmbedding:
    """Embed what the graph says about the task's objects.

    Args:
        config: where from and how.
        facets: the environment's (object, colour) pairs in its order.

    Raises:
        UserError: the graph, an object, a colour or a vector cannot be found; see the message.
    """
    slots = slots_of(config, facets)
    if not slots:
        empty = np.zeros((0, config.dim), np.float32)
        return SceneEmbedding(
            config=config, slots=(), matrix=empty, coverage=Coverage(), sentences=()
        )
    if config.colour_share is not None and not 0 <= config.colour_share <= 1:
        raise UserError(f"colour_share is {config.colour_share}; it must lie between 0 and 1.")
    matrix, coverage, sentences = _real_slots(config, slots)
    placebo = SLOT_PLACEBOS.get(config.source)
    note = NOTES.get(config.source, "")
    if placebo is not None:
        if config.source in ("onehot", "learned") and len(slots) > config.dim:
            raise UserError(
                f"{len(slots)} slots do not fit a one-hot of {config.dim} numbers. "
                f"Set --dim to {len(slots)} or more."
            )
        matrix, sentences = placebo(matrix, config.seed), ("",) * len(slots)
    return SceneEmbedding(
        config=config,
        slots=slots,
        matrix=matrix,
        coverage=coverage,
        sentences=sentences,
        note=note,
    )


NOTES = {
    "zeros": "placebo: zeros, the network's shape without knowledge",
    "random": "placebo: random numbers, each slot as long as the real one",
    "onehot": "placebo: one-hot slot numbers, as long as the real slots; identity without meaning",
    "shuffled": "placebo: the graph's tails are permuted within each relation",
    "wrong-object": "placebo: every slot describes another object than its own",
    "learned": "one-hot slot numbers; the policy learns the vectors itself (encoder 'learned')",
}
"""What reports say beside a placebo."""


def _real_slots(
    config: KnowledgeConfig, slots: Sequence[Facet]
) -> tuple[np.ndarray, Coverage, tuple[str, ...]]:
    """Return the slots' vectors (S, D) float32 before any placebo, coverage and sentences."""
    graph = load_graph(config)
    subgraphs, colours = slot_subgraphs(graph, slots, config)
    sentences = [sentence_parts(sub, config.sentence) for sub in subgraphs]
    everything = graph_parts(graph, relation_words=config.relation_words) if config.centring else []
    needed: list[Part] = [part for parts in sentences for part in parts]
    source = open_source(config, graph, needed + everything)
    centre = centre_of(source, everything) if config.centring else 0.0
    hue_centre = centre_of(source, _colours(graph, config)) if config.centring else 0.0
    coverage = Coverage()
    rows = [
        slot_vector(parts, colour, source, config, centre, hue_centre, coverage)
        for parts, colour in zip(sentences, colours, strict=True)
    ]
    said_words = tuple(" ".join(part.label for part in parts) for parts in sentences)
    return np.array(rows, np.float32), coverage, said_words


def _colours(graph: KnowledgeGraph, config: KnowledgeConfig) -> list[Part]:
    """Return the label of every colour that the graph knows."""
    if config.detail != "full":
        return []
    rows = graph.relations == graph.relation_id(config.colour_relation)
    names = [graph.names[i] for i in np.unique(graph.tails[rows])]
    return [Part(name, label_of(name, graph.labels), False) for name in names]
