"""Embeddings of scenes and of queries: graph -> sentences of slots -> vectors -> slots -> table.

A placebo falsifies one of these steps; see the methods ``change_...`` of `VectorSource`.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from knowarm.errors import Argument, UserError
from knowarm.knowledge.config import EmbeddingFacts, KnowledgeConfig, Scope
from knowarm.knowledge.formats import read_graph
from knowarm.knowledge.graph.denials import without_derived
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.slots import (
    Described,
    Sentence,
    describe_conditions,
    describe_facets,
    graph_parts,
    slots_of,
    words_of,
)
from knowarm.knowledge.vectors.source import (
    Coverage,
    Facet,
    Found,
    Pooling,
    Request,
    VectorLookup,
    Vectors,
)
from knowarm.questions import Condition, ObjectColour, Query, conditions_of

SIF_A = 1e-3
"""The constant of SIF's weight a / (a + p)."""
Facets = Sequence[ObjectColour]
"""The task's (object, colour) pairs, in the environment's order."""


@dataclass(frozen=True, kw_only=True)
class Embedding:
    """Slots of numbers with their names and their origin."""

    config: KnowledgeConfig
    """The config it was made by."""
    slots: tuple[Facet | Condition, ...]
    """Object and colour of each slot, or the condition of a query."""
    matrix: Vectors = field(repr=False)
    """The slots' vectors, (S, slot_dim) float32."""
    coverage: Coverage = field(repr=False)
    """How labels were found among the vectors."""
    sentences: tuple[str, ...] = field(repr=False)
    """Sentence of each slot; empty strings for placebos without one."""
    note: str = ""
    """Remark for reports; empty for most sources."""

    @property
    def scope(self) -> Scope:
        """Which slots the policy gets."""
        return self.config.scope

    @property
    def slot_dim(self) -> int:
        """Numbers per slot."""
        return int(self.matrix.shape[1])

    @property
    def slots_per_row(self) -> int:
        """Number of slots in a row of the table."""
        return self.dim // self.slot_dim

    @property
    def vector(self) -> Vectors:
        """All slots concatenated, (S * slot_dim,) float32."""
        return self.matrix.reshape(-1)

    @property
    def dim(self) -> int:
        """K, the width of the policy's input."""
        raise NotImplementedError

    @property
    def norm(self) -> float:
        """Euclidean norm of the vector."""
        return float(np.linalg.norm(self.vector.astype(np.float64)))

    @property
    def constant(self) -> bool:
        """Whether every episode gets the same numbers, which then act as a bias."""
        raise NotImplementedError

    @property
    def privileged(self) -> bool:
        """Whether the numbers identify the target of the episode."""
        return self.scope == "target" and not self.constant

    def describe(self) -> EmbeddingFacts:
        """Return the description that a run folder stores."""
        names = tuple(slot.name for slot in self.slots)
        norms = np.linalg.norm(self.matrix.astype(float), axis=1)
        return EmbeddingFacts(
            source=self.config.source.short_name,
            slots=names,
            slot_dim=self.slot_dim,
            dim=self.dim,
            norm=self.norm,
            note=self.note,
            slot_norms=tuple(norms.tolist()),
            coverage=self.coverage.describe(),
            sentences=dict(zip(names, self.sentences, strict=True)),
            constant=self.constant,
            privileged=self.privileged,
        )


@dataclass(frozen=True, kw_only=True)
class SceneEmbedding(Embedding):
    """Slots of objects, or of objects with colours."""

    slots: tuple[Facet, ...]
    """Object and colour of each slot."""

    @property
    def dim(self) -> int:
        """K, the width of the policy's input: S * slot_dim (scene) or slot_dim (one facet's)."""
        if self.scope == "scene":
            return self.matrix.size
        return self.slot_dim

    @property
    def constant(self) -> bool:
        """Whether every episode gets the same numbers, which then act as a bias."""
        return self.scope == "scene" or bool(np.ptp(self.matrix, axis=0).max() == 0)

    def table(self, facets: Facets) -> Vectors:
        """Return the knowledge input of the policy for each facet, (F, K) float32."""
        if self.scope == "scene":
            return np.tile(self.vector, (len(facets), 1))
        rows = []
        for name, colour in facets:
            wanted = Facet(name, None if self.config.detail == "partial" else colour)
            if wanted not in self.slots:
                names = ", ".join(slot.name for slot in self.slots)
                raise UserError(
                    f"No slot describes {wanted.name!r}. The slots are: {names}."
                )
            rows.append(self.slots.index(wanted))
        return self.matrix[rows]


@dataclass(frozen=True, kw_only=True)
class QueryEmbedding(Embedding):
    """Slots of conditions, and the conditions of each query."""

    slots: tuple[Condition, ...]
    """The condition of each slot."""
    queries: tuple[Query, ...] = field(repr=False)
    """Queries whose conditions have a slot."""

    @property
    def width(self) -> int:
        """Slots per row: the largest number of conditions in a query."""
        return max(len(query.conditions) for query in self.queries)

    @property
    def dim(self) -> int:
        """K, the width of the policy's input: width * slot_dim."""
        return self.width * self.slot_dim

    @property
    def constant(self) -> bool:
        """Whether every query gets the same numbers."""
        return bool(np.ptp(self.table(self.queries), axis=0).max() == 0)

    def table(self, queries: Sequence[Query]) -> Vectors:
        """Return the knowledge input of the policy for each embedded query, (Q, K) float32.

        Facts fill the slots of a row from the first, colours and objects from the last, so that a
        colour is found at one place in all queries; the rest is zero.

        Raises:
            UserError: no slot describes a condition.
        """
        slots = dict(zip(self.slots, self.matrix, strict=True))
        new = conditions_of(queries).keys() - slots.keys()
        if new:
            names = sorted(condition.name for condition in new)
            raise UserError(
                f"No slot describes {', '.join(names)}: embed the queries first."
            )
        rows = np.zeros((len(queries), self.width, self.slot_dim), np.float32)
        for row, query in zip(rows, queries, strict=True):
            seen = [c for c in query.conditions if c.is_seen]
            facts = [c for c in query.conditions if not c.is_seen]
            for place, condition in enumerate(facts):
                row[place] = slots[condition]
            for place, condition in enumerate(seen, self.width - len(seen)):
                row[place] = slots[condition]
        return rows.reshape(len(queries), -1)


def scene_embedding(
    config: KnowledgeConfig,
    facets: Facets,
    *,
    run_seed: int = 0,
    graph: KnowledgeGraph | None = None,
) -> SceneEmbedding:
    """Embed the facts of the graph about the task's objects.

    Args:
        config: the graph, the source of vectors and the choices between.
        facets: the environment's (object, colour) pairs in its order.
        run_seed: seed of the training run; only placebos that are drawn depend on it.
        graph: take this graph in place of the config's, such as an edited one.

    Raises:
        UserError: the graph, an object, a colour or a vector cannot be found.

    Example:
        >>> config = KnowledgeConfig(detail="full")
        >>> scene_embedding(config, [("mug", "red"), ("mug", "blue")]).matrix.shape
        (2, 50)
    """
    slots = slots_of(config, facets)
    return SceneEmbedding(**_embed(config, slots, describe_facets, graph, run_seed))


def query_embedding(
    config: KnowledgeConfig,
    queries: Sequence[Query],
    *,
    run_seed: int = 0,
    graph: KnowledgeGraph | None = None,
    trained_on: Sequence[Query] = (),
) -> QueryEmbedding:
    """Embed what the graph knows about the queries of a task.

    Args:
        config: the graph, the source of vectors and the choices between.
        queries: texts of the queries, such as "usedFor drinking and hasColor blue".
        run_seed: seed of the training run; only placebos that are drawn depend on it.
        graph: describe the queries by this graph in place of the config's, such as an edited one.
        trained_on: queries of the training, if these are others: a code that depends on the
            number of a condition then stays what it was.

    Raises:
        UserError: a label or condition cannot be found.

    Example:
        >>> config = KnowledgeConfig(detail="full", graph="objects", hops=0)
        >>> query_embedding(config, [Query.of(("usedFor", "drinking"))]).matrix.shape
        (1, 50)
    """
    embedded = tuple(dict.fromkeys((*trained_on, *queries)))
    slots = tuple(conditions_of(embedded))
    fields = _embed(config, slots, describe_conditions, graph, run_seed)
    return QueryEmbedding(queries=embedded, **fields)


def _embed(
    config: KnowledgeConfig,
    slots: tuple[Any, ...],
    describe: Callable[[Any, KnowledgeGraph, KnowledgeConfig, int], Described],
    graph: KnowledgeGraph | None,
    run_seed: int,
) -> dict[str, Any]:
    """Compute slots by the config's source; return all fields of `Embedding`."""
    source = config.source
    coverage = Coverage()
    matrix = np.zeros((len(slots), config.dim), np.float32)
    sentences = ["" for _ in slots]
    seed = source.draw_seed(config.seed, run_seed)
    if source.described:
        if graph is None:
            graph = read_graph(config.graph)
        described = describe(slots, without_derived(graph), config, seed)
        matrix = _vectors(config, described, coverage)
        if not source.content_free:
            sentences = [words_of(labels.sentence) for labels in described.slots]
    matrix = source.change_vectors(matrix, seed)
    if source.real is not source and not source.content_free:
        # A placebo with another content has slots as long as those of the source that it copies.
        real = replace(config, source=source.real)
        copied = _embed(real, slots, describe, graph, run_seed=0)["matrix"]
        wanted = np.linalg.norm(copied, axis=1, keepdims=True)
        length = np.linalg.norm(matrix, axis=1, keepdims=True)
        factor = np.divide(wanted, length, out=np.zeros_like(wanted), where=length > 0)
        matrix = (matrix * factor).astype(np.float32)
    return {
        "config": config,
        "slots": slots,
        "matrix": matrix,
        "coverage": coverage,
        "sentences": tuple(sentences),
        "note": source.note,
    }


def _vectors(
    config: KnowledgeConfig, described: Described, coverage: Coverage
) -> Vectors:
    """Return the slots' vectors, (S, D) float32; record how labels were found."""
    graph = described.graph
    everything = Sentence()
    if config.centring:
        everything = graph_parts(graph, relation_words=config.relation_words)
    parts = everything.copy()
    for slot in described.slots:
        parts += slot.sentence
    lookup = config.source.open(
        Request(
            graph=graph,
            parts=parts,
            dim=config.dim,
            seed=config.seed,
            aliases=config.aliases,
            on_missing=config.on_missing,
        )
    )
    if lookup.dim != config.dim:
        raise UserError(
            f"{lookup.name} has {lookup.dim} numbers per word, but the config expects "
            f"{config.dim}. Take vectors of {config.dim} numbers or set dim to {lookup.dim}."
        )
    centre = np.zeros(lookup.dim)
    value_centre = np.zeros(lookup.dim)
    if config.centring:
        centre = _centre(lookup, everything)
        if len(set(described.values)) > 1:  # a colour less itself would be nothing
            value_centre = _centre(lookup, described.values)
    share = config.colour_share
    rows = []
    for sentence, value, rest in described.slots:
        labels = sentence if share is None else rest
        found = [lookup.find(part, coverage) for part in labels]
        vector = _pool(found, config.pooling, centre)
        if value is not None and share is not None:
            found = [lookup.find(value, coverage)]
            value_unit = _unit(_pool(found, config.pooling, value_centre))
            mixed = (1 - share) * _unit(vector) + share * value_unit
            vector = mixed * np.linalg.norm(vector)
        if config.slot_norm is not None:
            vector = _unit(vector) * config.slot_norm
        rows.append(vector)
    return np.array(rows, np.float32)


def _centre(lookup: VectorLookup, parts: Sentence) -> Vectors:
    """Return the mean vector of labels, (D,) float64; labels that are not found are skipped."""
    vectors = [Found(np.empty((0, lookup.dim), np.float32), np.empty(0))]
    for label in parts:
        with suppress(UserError):
            vectors.append(lookup.find(label, Coverage()))
    return _pool(vectors, "mean", 0)


def _pool(found: Sequence[Found], pooling: Pooling, centre: Vectors | float) -> Vectors:
    """Pool the vectors of labels, less a centre (D,) or 0, into one, (D,) float64.

    mean: sum_w v_w / n;  sif: sum_w a / (a + p(w)) v_w / n  (Arora, Liang and Ma 2017, eq. 3).
    """
    vectors = np.concatenate([f.vectors for f in found]).astype(np.float64) - centre
    if not len(vectors):
        return np.zeros(vectors.shape[1])
    if pooling == "mean":
        return vectors.mean(axis=0)
    frequencies = np.concatenate([f.frequencies for f in found])
    return (vectors * (SIF_A / (SIF_A + frequencies))[:, None]).mean(axis=0)


def _unit(vector: Vectors) -> Vectors:
    length = np.linalg.norm(vector)
    if length == 0:
        raise UserError(
            "A slot's vector is zero, so it cannot be scaled: no word of its sentence is known. "
            "Give aliases, or use ",
            Argument("knows.on_missing", "hash"),
            ".",
        )
    return vector / length
