"""Names of agents and what each is told, and by which network: the paper's, ours, the controls."""

from dataclasses import dataclass, field, replace

from knowarm.experiment.config import NetworkConfig
from knowarm.knowledge import FULL, FULL_PLUS, KnowledgeConfig
from knowarm.knowledge.vectors import GraphEmbedding
from knowarm.knowledge.vectors.placebos import (
    Learned,
    OneHot,
    RandomVectors,
    ShuffledGraph,
    WrongObject,
    Zeros,
)


@dataclass(frozen=True, kw_only=True)
class AgentConfig:
    """What makes an agent: everything else is the same for all of them."""

    about: str
    """One line for ``knowarm list``."""
    knowledge: KnowledgeConfig
    """What it is told."""
    network: NetworkConfig = field(default_factory=NetworkConfig)
    """How its network takes it in."""


AGENTS: dict[str, AgentConfig] = {
    "bm": AgentConfig(
        about="baseline: no knowledge (paper)", knowledge=KnowledgeConfig(detail="none")
    ),
    "partial": AgentConfig(
        about="object types only (paper)", knowledge=KnowledgeConfig(detail="partial")
    ),
    "full": AgentConfig(about="object types and colours (paper)", knowledge=FULL),
    "full+": AgentConfig(
        about="as full, with an embedding that keeps facets apart", knowledge=FULL_PLUS
    ),
    "analogy": AgentConfig(
        about="as full, from ANALOGY embeddings (the paper's first choice)",
        knowledge=replace(FULL, source=GraphEmbedding(), relation_words=False),
    ),
    "target": AgentConfig(
        about="told the episode's own object and colour (privileged)",
        knowledge=replace(FULL, scope="target"),
    ),
    "target+": AgentConfig(
        about="as target, with the embedding of full+ (privileged)",
        knowledge=replace(FULL_PLUS, scope="target"),
    ),
    "target-onehot": AgentConfig(
        about="control of target: a number for the facet, no meaning (privileged)",
        knowledge=replace(FULL, source=OneHot(), scope="target"),
    ),
    "zeros": AgentConfig(
        about="control: full's shape, all zeros", knowledge=replace(FULL, source=Zeros())
    ),
    "random": AgentConfig(
        about="control: full's shape and norm, random",
        knowledge=replace(FULL, source=RandomVectors()),
    ),
    "shuffled": AgentConfig(
        about="control: full from a graph with permuted tails",
        knowledge=replace(FULL, source=ShuffledGraph()),
    ),
    "onehot": AgentConfig(about="control: one-hot slots", knowledge=replace(FULL, source=OneHot())),
    "wrong-object": AgentConfig(
        about="control: each slot describes another object",
        knowledge=replace(FULL, source=WrongObject()),
    ),
    "learned": AgentConfig(
        about="control: the vector is learned with the policy",
        knowledge=replace(FULL, source=Learned()),
    ),
    "wide": AgentConfig(
        about="control: no knowledge, full's LSTM size and parameter count",
        knowledge=FULL,
        network=NetworkConfig(wide=True),
    ),
    "full-fixed": AgentConfig(
        about="full with the baseline's LSTM size",
        knowledge=FULL,
        network=NetworkConfig(hidden="fixed"),
    ),
    "full-before-fc": AgentConfig(
        about="full, entering before the fully connected layer",
        knowledge=FULL,
        network=NetworkConfig(fusion="before_fc"),
    ),
    "full-after-lstm": AgentConfig(
        about="full, entering after the LSTM",
        knowledge=FULL,
        network=NetworkConfig(fusion="after_lstm", hidden="fixed"),
    ),
    "full-film": AgentConfig(
        about="full, scaling and shifting the convolution features",
        knowledge=FULL,
        network=NetworkConfig(fusion="film", hidden="fixed"),
    ),
    "full-attention": AgentConfig(
        about="full, attended to slot by slot",
        knowledge=FULL,
        network=NetworkConfig(fusion="attention", hidden="fixed"),
    ),
    "full-critic": AgentConfig(
        about="full, for the critic alone",
        knowledge=FULL,
        network=NetworkConfig(fusion="critic", hidden="fixed"),
    ),
}
"""Every agent by name. A new one is one entry here."""
