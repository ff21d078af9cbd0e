"""Names of agents and what each is told, and by which network: the paper's, ours, the controls."""

from dataclasses import dataclass, field

from knowarm.experiment.config import NetworkConfig
from knowarm.knowledge.config import KnowledgeConfig
from knowarm.knowledge.presets import FULL, KNOWLEDGE


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
    "bm": AgentConfig(about="baseline: no knowledge (paper)", knowledge=KNOWLEDGE["bm"]),
    "partial": AgentConfig(about="object types only (paper)", knowledge=KNOWLEDGE["partial"]),
    "full": AgentConfig(about="object types and colours (paper)", knowledge=FULL),
    "full+": AgentConfig(
        about="as full, with an embedding that keeps facets apart", knowledge=KNOWLEDGE["full+"]
    ),
    "analogy": AgentConfig(
        about="as full, from ANALOGY embeddings (the paper's first choice)",
        knowledge=KNOWLEDGE["analogy"],
    ),
    "target": AgentConfig(
        about="told the episode's own object and colour (privileged)",
        knowledge=KNOWLEDGE["target"],
    ),
    "target+": AgentConfig(
        about="as target, with the embedding of full+ (privileged)",
        knowledge=KNOWLEDGE["target+"],
    ),
    "target-onehot": AgentConfig(
        about="control of target: a number for the facet, no meaning (privileged)",
        knowledge=KNOWLEDGE["target-onehot"],
    ),
    "zeros": AgentConfig(about="control: full's shape, all zeros", knowledge=KNOWLEDGE["zeros"]),
    "random": AgentConfig(
        about="control: full's shape and norm, random", knowledge=KNOWLEDGE["random"]
    ),
    "shuffled": AgentConfig(
        about="control: full from a graph with permuted tails", knowledge=KNOWLEDGE["shuffled"]
    ),
    "onehot": AgentConfig(about="control: one-hot slots", knowledge=KNOWLEDGE["onehot"]),
    "wrong-object": AgentConfig(
        about="control: each slot describes another object", knowledge=KNOWLEDGE["wrong-object"]
    ),
    "learned": AgentConfig(
        about="control: the vector is learned with the policy", knowledge=KNOWLEDGE["learned"]
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
