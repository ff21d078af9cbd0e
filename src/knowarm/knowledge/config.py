"""All that an experiment says about its knowledge."""

from dataclasses import dataclass, field
from typing import Literal

from knowarm.knowledge.sentence import SentenceConfig
from knowarm.knowledge.subgraph import Direction
from knowarm.knowledge.vectors.words import OnMissing

Detail = Literal["none", "partial", "full"]
Scope = Literal["scene", "target"]
Pooling = Literal["mean", "sif"]


@dataclass(frozen=True, kw_only=True)
class KnowledgeConfig:
    """From a graph to the vector that enters the policy; the defaults are the paper's way."""

    detail: Detail
    """What a slot describes: "none" gives no vector (the paper's baseline); "partial" each object
    without its colours; "full" each object with one of its possible colours."""
    source: str = "wordnet-gloss-50"
    """Where vectors come from: shipped word vectors ("wordnet-gloss-50"), the path of a file in
    GloVe's format, a graph embedding trained on the graph ("analogy", "transe", "distmult",
    "complex", "rotate") or the .safetensors file of one fitted before, a sentence encoder
    ("sentence-transformers:PATH"), or a placebo ("zeros", "random", "onehot", "shuffled",
    "wrong-object", "learned")."""
    matches: str = "wordnet-gloss-50"
    """The real source whose shape and norm a placebo copies; unused without a placebo."""
    graph: str | None = None
    """Path of the graph; None takes the shipped household graph."""
    scope: Scope = "scene"
    """"scene" gives every episode the same vector of all slots (the paper's). "target" gives the
    slot of the episode's own object and colour: information that no camera saw, so privileged."""
    dim: int = 50
    """Numbers a slot: a vector file must have as many, a graph embedding is made with as many."""
    hops: int = 1
    """How many edges from the object Gamma goes."""
    direction: Direction = "out"
    """Edges that Gamma follows: "out" (the object is the head), "in" or "both"."""
    relations: tuple[str, ...] | None = None
    """Relations that Gamma follows; None follows all."""
    max_degree: int | None = None
    """Entities with more edges than this are not expanded; None sets no limit."""
    colour_relation: str = "hasColor"
    """The relation whose tails are an object's colours."""
    relation_words: bool = True
    """Whether the labels of edges belong to the sentence."""
    head_once: bool = False
    """Whether the sentence names the object once, or anew in each fact (the paper's)."""
    templates: dict[str, str] = field(default_factory=dict)
    """Words for a relation instead of its label: {"isMadeOf": "made of"}."""
    pooling: Pooling = "mean"
    """How the vectors of a sentence become one: their mean (the paper's), or a mean weighted by
    a / (a + frequency), a = 0.001 (SIF: Arora, Liang and Ma 2017)."""
    centring: bool = False
    """Whether the mean vector of the whole graph's labels is subtracted from each word (and the
    mean of all colours from a colour that has a share of its own)."""
    colour_share: float | None = None
    """Share of a slot that its own colour takes, 0 to 1; the rest is the object's. None counts
    the colour's words like all others, and twenty other words then drown them."""
    slot_norm: float | None = None
    """Length that every slot is scaled to; None leaves each as it comes."""
    entity_names: dict[str, str] = field(default_factory=dict)
    """The graph's name for an object or colour of the task, where they differ."""
    aliases: dict[str, str] = field(default_factory=dict)
    """Other words for labels that the vectors do not know."""
    on_missing: OnMissing = "error"
    """What happens to a label of which no word is known: "error", "skip", or "hash" (a fixed
    random vector made of its letters)."""
    seed: int = 0
    """Seed of graph embeddings and placebos."""

    @property
    def sentence(self) -> SentenceConfig:
        """How a subgraph becomes words."""
        return SentenceConfig(
            relation_words=self.relation_words, head_once=self.head_once, templates=self.templates
        )
