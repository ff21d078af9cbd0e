"""A graph, vectors and the task's (object, colour) pairs go in; what the policy is given comes out.

graph -> Gamma -> sentence -> vectors -> one slot a facet -> slots side by side
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from knowarm.errors import UserError
from knowarm.knowledge.config import KnowledgeConfig, Scope
from knowarm.knowledge.facets import Facet, facet_subgraph, slots_of
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.household import household
from knowarm.knowledge.labels import label_of
from knowarm.knowledge.pooling import slot_vector
from knowarm.knowledge.read import read_graph
from knowarm.knowledge.sentence import Part, sentence, sentence_parts
from knowarm.knowledge.vectors.coverage import Coverage
from knowarm.knowledge.vectors.open import centre_of, graph_parts, open_source
from knowarm.knowledge.vectors.placebos import SLOT_PLACEBOS, shuffle_tails

Facets = Sequence[tuple[str, str]]
"""The task's (object, colour) pairs, in the environment's order."""


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


def load_graph(config: KnowledgeConfig) -> KnowledgeGraph:
    """Return the config's graph, shuffled where it is the placebo that asks for it."""
    graph = household() if config.graph is None else read_graph(config.graph)
    return shuffle_tails(graph, config.seed) if config.source == "shuffled" else graph


def scene_subgraphs(config: KnowledgeConfig, facets: Facets) -> dict[str, KnowledgeGraph]:
    """Return what the graph says about each slot, by the slot's name."""
    graph, slots = load_graph(config), slots_of(config, facets)
    return {
        slot.name: sub for slot, sub in zip(slots, _subgraphs(graph, slots, config)[0], strict=True)
    }


def scene_subgraph(config: KnowledgeConfig, facets: Facets) -> KnowledgeGraph:
    """Return what the graph says about all slots together."""
    graph = load_graph(config)
    subgraphs, _ = _subgraphs(graph, slots_of(config, facets), config)
    triples = [np.stack([s.heads, s.relations, s.tails], axis=1) for s in subgraphs]
    nodes = [s.nodes for s in subgraphs]
    empty = np.empty((0, 3), np.int32)
    return KnowledgeGraph(
        graph.names,
        graph.relation_names,
        np.concatenate([empty, *triples]),
        nodes=np.concatenate([empty[:, 0], *nodes]),
        labels=graph.labels,
    )


def scene_sentences(config: KnowledgeConfig, facets: Facets) -> dict[str, str]:
    """Return the sentence of each slot, by the slot's name."""
    return {
        name: sentence(sub, config.sentence)
        for name, sub in scene_subgraphs(config, facets).items()
    }


def _real_slots(
    config: KnowledgeConfig, slots: Sequence[Facet]
) -> tuple[np.ndarray, Coverage, tuple[str, ...]]:
    """Return the slots' vectors (S, D) float32 before any placebo, coverage and sentences."""
    graph = load_graph(config)
    subgraphs, colours = _subgraphs(graph, slots, config)
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


def _subgraphs(
    graph: KnowledgeGraph, slots: Sequence[Facet], config: KnowledgeConfig
) -> tuple[list[KnowledgeGraph], list[str | None]]:
    """Return each slot's subgraph and its colour's name in the graph."""
    false = config.source in ("shuffled", "wrong-object")
    described = _wrong_objects(graph, slots, config) if config.source == "wrong-object" else slots
    subgraphs: list[KnowledgeGraph] = []
    colours: list[str | None] = []
    for place, facet in enumerate(described):
        index = None
        if false and facet.colour is not None:
            index = sum(other.object == facet.object for other in described[:place])
        subgraph = facet_subgraph(graph, facet, config, index)
        subgraphs.append(subgraph)
        colours.append(_colour_of(subgraph, facet, config))
    return subgraphs, colours


def _colour_of(subgraph: KnowledgeGraph, facet: Facet, config: KnowledgeConfig) -> str | None:
    """Return the graph's name of the one colour that is left in a facet's subgraph."""
    if facet.colour is None:
        return None
    entity = subgraph.entity_id(config.entity_names.get(facet.object, facet.object))
    relation = subgraph.relation_id(config.colour_relation)
    rows = np.flatnonzero((subgraph.heads == entity) & (subgraph.relations == relation))
    return subgraph.names[subgraph.tails[rows[0]]] if len(rows) else None


def _wrong_objects(
    graph: KnowledgeGraph, slots: Sequence[Facet], config: KnowledgeConfig
) -> list[Facet]:
    """Give each object another one of the graph with as many colours, drawn by the seed."""
    true = list(dict.fromkeys(slot.object for slot in slots))
    needed = max(sum(slot.object == name for slot in slots) for name in true)
    in_task = {graph.entity_id(config.entity_names.get(name, name)) for name in true}
    relation = graph.relation_id(config.colour_relation)
    heads, colours = np.unique(graph.heads[graph.relations == relation], return_counts=True)
    heads = heads[colours >= needed]
    others = [graph.names[i] for i in heads if i not in in_task]
    if len(others) < len(true):
        raise UserError(
            f"The placebo 'wrong-object' needs {len(true)} other objects with {needed} "
            f"colours in the graph, which has {len(others)}. Take another placebo, e.g. 'shuffled'."
        )
    drawn = np.random.default_rng(config.seed).choice(len(others), len(true), replace=False)
    false = {name: others[i] for name, i in zip(true, drawn, strict=True)}
    return [replace(slot, object=false[slot.object]) for slot in slots]
