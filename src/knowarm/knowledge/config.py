"""Configuration of the knowledge of an agent: from a graph to the vector that the policy gets."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, get_args

from knowarm.config import check_values, registered
from knowarm.knowledge.graph.graph import Direction
from knowarm.knowledge.vectors import SOURCES, VectorSource
from knowarm.knowledge.vectors.placebos import Zeros
from knowarm.knowledge.vectors.source import OnMissing, Pooling
from knowarm.knowledge.vectors.words import WordVectors

Detail = Literal["partial", "full"]
Scope = Literal["nothing", "scene", "target", "query"]
"""What a row of the knowledge table describes: nothing, all slots (the same in every episode), the
slot of the episode's own object and colour, or its query."""


@dataclass(frozen=True, kw_only=True)
class KnowledgeConfig:
    """Choices between a graph and the vector that enters the policy; defaults are the paper's."""

    detail: Detail
    """What a slot describes: "partial" each object without its colours; "full" each object with one
    of its possible colours."""
    source: VectorSource = field(
        default_factory=WordVectors, metadata=registered(lambda: SOURCES.values())
    )
    """Where vectors come from: one of the configs in `knowledge.vectors.SOURCES`, which are word
    vectors, graph embeddings, sentence encoders and placebos."""
    graph: str | None = None
    """Path of the graph, or the name of a shipped one ("household", "objects"); None takes the
    household graph."""
    dim: int = 50
    """Dimension of the vectors of `source`: numbers per slot, or per label of a fact."""
    hops: int = 1
    """Largest number of edges between the object and an entity of its subgraph (Gamma)."""
    direction: Direction = "out"
    """Edges that Gamma follows: "out" (the object is the head), "in" or "both"."""
    relations: tuple[str, ...] | None = None
    """Relations that Gamma follows; None follows all."""
    max_degree: int | None = None
    """Entities with more edges than this are not expanded, but for the objects themselves; None
    sets no limit."""
    colour_relation: str = "hasColor"
    """The relation whose tails are an object's colours."""
    relation_words: bool = True
    """Whether the labels of edges belong to the sentence."""
    templates: dict[str, str] = field(default_factory=dict)
    """Words for a relation instead of its label, in pairs: isMadeOf "made of"."""
    pooling: Pooling = "mean"
    """How the vectors of a sentence become one: their mean (the paper's), or a mean weighted by
    a / (a + frequency), a = 0.001 (SIF: Arora, Liang and Ma 2017)."""
    centring: bool = False
    """Whether the mean vector of the whole graph's labels is subtracted from each word (and the
    mean of all colours from a colour that has a share of its own)."""
    colour_share: float | None = None
    """Share of a slot that its own colour takes, 0 to 1; the rest is the object's. None gives the
    colour's words the weight of all others, which makes slots of one object nearly equal. Of a
    query: the share of the value that is asked for; the rest is its subgraph's."""
    slot_norm: float | None = None
    """Length that every slot is scaled to; None keeps the pooled length."""
    entity_names: dict[str, str] = field(default_factory=dict)
    """The graph's name for an object or colour of the task, where they differ."""
    aliases: dict[str, str] = field(default_factory=dict)
    """Other words for labels that the vectors do not know."""
    on_missing: OnMissing = "error"
    """What to do with a label of which no word is known: "error", "skip", or "hash" (a fixed
    random vector that depends on its letters)."""
    seed: int = 0
    """Seed of graph embeddings and placebos; placebos that are drawn also depend on the training
    seed."""

    def __post_init__(self) -> None:
        check_values(self)

    @property
    def scope(self) -> Scope:
        """What a row of the table describes; another one in classes that inherit."""
        return "scene"

    @property
    def rank(self) -> int:
        """Place among configs by how much of the objects is described, from 1."""
        return 1 + get_args(Detail).index(self.detail)

    @property
    def has_content(self) -> bool:
        """Whether there is a vector that is not all zeros."""
        return not isinstance(self.source, Zeros)

    def graph_name(self, name: str) -> str:
        """Return the graph's name for an object or colour of the task."""
        return self.entity_names.get(name, name)


@dataclass(frozen=True, kw_only=True)
class EmbeddingFacts:
    """Description of an embedding in a run folder: see the attributes of `Embedding`."""

    source: str
    """Short name of the source of vectors."""
    slots: tuple[str, ...]
    slot_dim: int
    dim: int
    norm: float
    slot_norms: tuple[float, ...]
    coverage: Mapping[str, Any]
    """Of `Coverage.describe`."""
    sentences: Mapping[str, str]
    """Sentence of each slot."""
    constant: bool
    privileged: bool
    note: str


FULL = KnowledgeConfig(detail="full")
"""The paper's: mean of all words of the sentence, one slot per object and colour."""

FULL_PLUS = KnowledgeConfig(
    detail="full",
    relation_words=False,
    pooling="sif",
    centring=True,
    colour_share=0.6,
    slot_norm=1.0,
)
"""Slots in which every pair of objects and colours can be distinguished (see `knowledge.probe`)."""

QUERY = replace(
    FULL_PLUS,
    graph="objects",
    direction="both",
    colour_share=0.5,
    aliases={"cyan": "blue green", "dumbbell": "weight", "toolbox": "tool box"},
)
"""One slot per condition of the query: half its value, half what the graph links to the value,
from the objects that have it to other values."""
