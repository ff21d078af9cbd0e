"""Scene embedding: slots of numbers that describe the task's objects.

Pipeline: graph -> Gamma -> sentence -> vectors -> one slot per facet -> slots concatenated.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from knowarm.errors import UserError
from knowarm.knowledge.config import KnowledgeConfig, Scope
from knowarm.knowledge.facets import Facet, slots_of, with_seen_colours
from knowarm.knowledge.formats import open_graph
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.pooling import centre_of, slot_vector
from knowarm.knowledge.queries import Condition
from knowarm.knowledge.scene import Facets, load_graph, slot_subgraphs
from knowarm.knowledge.sentence import Part, graph_parts, sentence_parts
from knowarm.knowledge.terms import label_of
from knowarm.knowledge.vectors.placebos import Placebo
from knowarm.knowledge.vectors.source import CodeSource, Coverage, Request, VectorSource


@dataclass(frozen=True, kw_only=True)
class SceneEmbedding:
    """Slots of numbers with their names and their origin."""

    config: KnowledgeConfig
    """The config it was made by."""
    slots: tuple[Facet | Condition, ...]
    """Object and colour of each slot, or the condition of a query; empty for detail "none"."""
    matrix: np.ndarray = field(repr=False)
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
    def vector(self) -> np.ndarray:
        """All slots concatenated, (S * slot_dim,) float32."""
        return self.matrix.reshape(-1)

    @property
    def dim(self) -> int:
        """K, the width of the policy's input: S * slot_dim (scene) or slot_dim (one facet's)."""
        if not self.slots:
            return 0
        return self.matrix.size if self.scope == "scene" else self.slot_dim

    @property
    def norm(self) -> float:
        """Euclidean norm of the vector."""
        return float(np.linalg.norm(self.vector.astype(np.float64)))

    @property
    def constant(self) -> bool:
        """Whether every episode gets the same numbers, which then act as a bias."""
        return self.dim > 0 and (
            self.scope == "scene" or bool(np.ptp(self.matrix, axis=0).max() == 0)
        )

    @property
    def privileged(self) -> bool:
        """Whether the numbers identify the target of the episode."""
        return self.dim > 0 and self.scope == "target" and not self.constant

    def table(self, facets: Facets) -> np.ndarray:
        """Return the knowledge input of the policy for each facet, (F, K) float32.

        Raises:
            UserError: a facet has no slot (other scopes than "scene").
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
        """Return the description that a run folder stores, JSON-able."""
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
        UserError: the graph, an object, a colour or a vector cannot be found, or the config
            describes queries.

    Example:
        >>> config = KnowledgeConfig(detail="full")
        >>> scene_embedding(config, [("mug", "red"), ("mug", "blue")]).matrix.shape
        (2, 50)
    """
    if config.scope == "query":
        raise UserError(
            "scope 'query' describes what an episode asks for, and this task asks for nothing: "
            "every episode shows one object. Use it in a task that asks queries, or set scope to "
            "'scene', 'target' or 'perceived'."
        )
    slots, stated = slots_of(config, facets), graph
    if config.scope == "perceived" and slots:
        stated = with_seen_colours(
            open_graph(config.graph) if graph is None else graph, slots, config
        )

    def describe(config: KnowledgeConfig, run_seed: int) -> Described:
        changed = load_graph(config, run_seed, stated)
        subgraphs, colours = slot_subgraphs(changed, slots, config, run_seed)
        sentences = [sentence_parts(each, config.sentence) for each in subgraphs]
        return Described(changed, sentences, colours, _colours(changed, config))

    matrix, sentences, coverage = slot_matrix(config, len(slots), describe, run_seed)
    return SceneEmbedding(
        config=config,
        slots=slots,
        matrix=matrix,
        coverage=coverage,
        sentences=sentences,
        note=config.source.note if slots else "",
    )


class Described(NamedTuple):
    """What slots are computed from."""

    graph: KnowledgeGraph
    """The graph, changed where the source is a placebo that does so."""
    sentences: list[list[Part]]
    """The sentence of each slot."""
    colours: Sequence[str | None]
    """The graph's name of each slot's colour, or None."""
    hues: list[Part]
    """Labels of all colours of the graph."""


def slot_matrix(
    config: KnowledgeConfig,
    count: int,
    describe: Callable[[KnowledgeConfig, int], Described],
    run_seed: int,
) -> tuple[np.ndarray, tuple[str, ...], Coverage]:
    """Compute slots from their descriptions by the config's source.

    Args:
        config: the source and how vectors are pooled.
        count: number of slots, S.
        describe: returns the descriptions for a config and a training seed.
        run_seed: seed of the training run, for placebos that are drawn.

    Returns:
        The slots (S, D) float32, their sentences (empty for placebos without one), and how labels
        were found.
    """
    source, coverage, nothing = config.source, Coverage(), ("",) * count
    if config.colour_share is not None and not 0 <= config.colour_share <= 1:
        raise UserError(f"colour_share is {config.colour_share}; it must lie between 0 and 1.")
    if not count:
        return np.zeros((0, config.dim), np.float32), nothing, coverage
    if isinstance(source, CodeSource):
        return source.code(count, config.dim), nothing, coverage
    if not isinstance(source, VectorSource):
        raise UserError(f"source must be a VectorSource or a CodeSource, got {source!r}.")
    described = describe(config, run_seed)
    matrix = _pooled_slots(config, source, described, coverage)
    changed = source.change_slots(matrix, source.draw_seed(config.seed, run_seed))
    if changed is not None:
        return changed, nothing, coverage
    if isinstance(source, Placebo):
        real_config = replace(config, source=source.matches)
        real = _pooled_slots(real_config, source.matches, describe(real_config, 0), Coverage())
        matrix = _with_lengths(matrix, real)
    words = tuple(" ".join(part.label for part in parts) for parts in described.sentences)
    return matrix, words, coverage


def _with_lengths(matrix: np.ndarray, real: np.ndarray) -> np.ndarray:
    """Scale each slot of a placebo (S, D) to the length of the real one, so norms are equal."""
    wanted, found = (np.linalg.norm(each, axis=1, keepdims=True) for each in (real, matrix))
    factor = np.divide(wanted, found, out=np.zeros_like(wanted), where=found > 0)
    return (matrix * factor).astype(np.float32)


def _pooled_slots(
    config: KnowledgeConfig, source: VectorSource, described: Described, coverage: Coverage
) -> np.ndarray:
    """Return the slots' vectors, (S, D) float32; record how labels were found."""
    graph, sentences, colours, hues = described
    everything = graph_parts(graph, relation_words=config.relation_words) if config.centring else []
    lookup = source.open(
        Request(
            graph=graph,
            parts=[*(part for parts in sentences for part in parts), *everything],
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
    centre = centre_of(lookup, everything) if config.centring else 0.0
    hue_centre = centre_of(lookup, hues) if config.centring else 0.0
    rows = [
        slot_vector(parts, colour, lookup, config, centre, hue_centre, coverage)
        for parts, colour in zip(sentences, colours, strict=True)
    ]
    return np.array(rows, np.float32)


def _colours(graph: KnowledgeGraph, config: KnowledgeConfig) -> list[Part]:
    """Return the label of every colour in the graph."""
    if config.detail != "full":
        return []
    rows = graph.relations == graph.relation_id(config.colour_relation)
    names = [graph.names[i] for i in np.unique(graph.tails[rows])]
    return [Part(name, label_of(name, graph.labels), False) for name in names]
