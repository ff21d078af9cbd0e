"""Registry of agents: the knowledge and the policy network of each, and its role in a study."""

from dataclasses import dataclass, field, replace
from typing import Any, Literal

from knowarm.experiment.grounding import GroundingConfig
from knowarm.knowledge import FULL, FULL_PLUS, QUERY, KnowledgeConfig
from knowarm.knowledge.vectors import GraphEmbedding
from knowarm.knowledge.vectors.placebos import (
    Learned,
    OneHot,
    Placebo,
    RandomVectors,
    ShuffledGraph,
    WrongObject,
    Zeros,
)
from knowarm.policy.config import PolicyConfig

Role = Literal["baseline", "knowledge", "capacity_control", "content_control", "privileged"]
"""What an agent is for in a comparison:

- ``baseline``: no knowledge vector;
- ``knowledge``: a vector computed from the graph;
- ``capacity_control``: as many parameters or inputs as with knowledge, but nothing in them;
- ``content_control``: a vector of the same shape whose content is not the graph's meaning;
- ``privileged``: a vector that identifies the episode's target, which no camera observed.
"""


@dataclass(frozen=True, kw_only=True)
class Agent:
    """The choices in which agents differ; robot, task and algorithm are the experiment's."""

    about: str
    """One line for ``knowarm list``."""
    role: Role
    """What the agent is for in a comparison; reports and their verdicts depend on it."""
    knowledge: KnowledgeConfig
    """From the graph to the knowledge vector."""
    policy: PolicyConfig = field(default_factory=PolicyConfig)
    """Choices of the policy network."""
    grounding: GroundingConfig | None = None
    """Network that finds what the query means (`ExperimentConfig.grounding`)."""
    marked: bool = False
    """Whether the image marks the object that is meant (choice task only)."""
    colour: str | None = None
    """Class of the report's palette that draws the agent in every chart (``c-blue``); None takes
    a spare one."""


def _control(about: str, knowledge: KnowledgeConfig, source: Placebo, **fields: Any) -> Agent:
    """Return a content control: the knowledge of a subject with other content.

    All choices but the source stay, so that scope, width, number of slots and norm are equal.
    """
    return Agent(
        about=f"control of {about}",
        role="content_control",
        knowledge=replace(knowledge, source=source),
        **fields,
    )


_TARGET = replace(FULL, scope="target")
_TARGET_PLUS = replace(FULL_PLUS, scope="target")
_PERCEIVED = replace(FULL_PLUS, scope="perceived")
_QUERY_WORDS = replace(QUERY, hops=0, colour_share=None)
_GROUNDED: dict[str, Any] = {
    "policy": PolicyConfig(hidden="fixed"),
    "grounding": GroundingConfig(),
}
"""Choices of the agents that are told a query: a network finds in the image what it means."""

AGENTS: dict[str, Agent] = {
    "bm": Agent(
        about="baseline: no knowledge (paper)",
        role="baseline",
        knowledge=KnowledgeConfig(detail="none"),
        colour="c-orange",
    ),
    "full": Agent(
        about="object types and colours (paper)", role="knowledge", knowledge=FULL, colour="c-blue"
    ),
    "partial": Agent(
        about="object types only (paper)",
        role="knowledge",
        knowledge=KnowledgeConfig(detail="partial"),
        colour="c-green",
    ),
    "full+": Agent(
        about="as full, with an embedding that keeps facets apart",
        role="knowledge",
        knowledge=FULL_PLUS,
        colour="c-navy",
    ),
    "analogy": Agent(
        about="as full, from ANALOGY embeddings (the paper's first choice)",
        role="knowledge",
        knowledge=replace(FULL, source=GraphEmbedding(model="analogy"), relation_words=False),
    ),
    "target": Agent(
        about="the slot of the episode's own object and colour (privileged)",
        role="privileged",
        knowledge=_TARGET,
        colour="c-gold",
    ),
    "target+": Agent(
        about="as target, with the embedding of full+ (privileged)",
        role="privileged",
        knowledge=_TARGET_PLUS,
    ),
    "target-zeros": Agent(
        about="control of target and target+: their shape, all zeros",
        role="capacity_control",
        knowledge=replace(_TARGET, source=Zeros()),
    ),
    "target-random": _control("target: one random vector per facet", _TARGET, RandomVectors()),
    "target-shuffled": _control(
        "target: from a graph with permuted tails", _TARGET, ShuffledGraph()
    ),
    "target-onehot": _control("target: the index of the facet, no meaning", _TARGET, OneHot()),
    "target-random+": _control("target+, as target-random", _TARGET_PLUS, RandomVectors()),
    "target-shuffled+": _control("target+, as target-shuffled", _TARGET_PLUS, ShuffledGraph()),
    "target-onehot+": _control("target+, as target-onehot", _TARGET_PLUS, OneHot()),
    "target-perceived": Agent(
        about="the slot of the object and colour that a perception module names in the image",
        role="knowledge",
        knowledge=_PERCEIVED,
    ),
    "target-perceived-zeros": Agent(
        about="control of target-perceived: its shape, all zeros",
        role="capacity_control",
        knowledge=replace(_PERCEIVED, source=Zeros()),
    ),
    "target-perceived-onehot": _control(
        "target-perceived: the index of what was named, no meaning", _PERCEIVED, OneHot()
    ),
    "target-perceived-random": _control(
        "target-perceived: one random vector per facet", _PERCEIVED, RandomVectors()
    ),
    "zeros": Agent(
        about="control of full and full+: their shape, all zeros",
        role="capacity_control",
        knowledge=replace(FULL, source=Zeros()),
        colour="c-grey",
    ),
    "random": _control(
        "full: its shape and norm, random", FULL, RandomVectors(), colour="c-purple"
    ),
    "shuffled": _control(
        "full: from a graph with permuted tails", FULL, ShuffledGraph(), colour="c-pink"
    ),
    "onehot": _control("full: one-hot slots", FULL, OneHot(), colour="c-teal"),
    "random+": _control("full+, as random", FULL_PLUS, RandomVectors()),
    "shuffled+": _control("full+, as shuffled", FULL_PLUS, ShuffledGraph()),
    "onehot+": _control("full+, as onehot", FULL_PLUS, OneHot()),
    "wrong-object": _control("full: each slot describes another object", FULL, WrongObject()),
    "learned": Agent(
        about="control: the vector is learned with the policy",
        role="content_control",
        knowledge=replace(FULL, source=Learned()),
        policy=PolicyConfig(knowledge_encoder="learned"),
    ),
    "wide": Agent(
        about="control: no knowledge, full's parameter count in a larger LSTM",
        role="capacity_control",
        knowledge=FULL,
        policy=PolicyConfig(wide=True),
        colour="c-brown",
    ),
    "full-fixed": Agent(
        about="full with the baseline's LSTM size",
        role="knowledge",
        knowledge=FULL,
        policy=PolicyConfig(hidden="fixed"),
    ),
    "full-before-fc": Agent(
        about="full, concatenated before the fully connected layer",
        role="knowledge",
        knowledge=FULL,
        policy=PolicyConfig(fusion="before_fc"),
    ),
    "full-after-lstm": Agent(
        about="full, concatenated after the LSTM",
        role="knowledge",
        knowledge=FULL,
        policy=PolicyConfig(fusion="after_lstm", hidden="fixed"),
    ),
    "full-film": Agent(
        about="full, scaling and shifting the convolution features",
        role="knowledge",
        knowledge=FULL,
        policy=PolicyConfig(fusion="film", hidden="fixed"),
    ),
    "full-attention": Agent(
        about="full, with attention over its slots",
        role="knowledge",
        knowledge=FULL,
        policy=PolicyConfig(fusion="attention", hidden="fixed"),
    ),
    "full-critic": Agent(
        about="full, for the critic only",
        role="knowledge",
        knowledge=FULL,
        policy=PolicyConfig(fusion="critic", hidden="fixed"),
    ),
    "mask": Agent(
        about="upper bound of the choice task: the image marks the object that is meant",
        role="privileged",
        knowledge=replace(QUERY, source=Zeros()),
        **_GROUNDED,
        marked=True,
        colour="c-gold",
    ),
    "subgraph": Agent(
        about="the subgraph around the values of the query",
        role="knowledge",
        knowledge=QUERY,
        **_GROUNDED,
        colour="c-blue",
    ),
    "subgraph-before-lstm": Agent(
        about="as subgraph, concatenated before the LSTM as in the paper",
        role="knowledge",
        knowledge=QUERY,
    ),
    "subgraph-similarity": Agent(
        about="as subgraph, fused by similarity without a grounding network",
        role="knowledge",
        knowledge=QUERY,
        policy=PolicyConfig(fusion="similarity", hidden="fixed"),
    ),
    "query-words": Agent(
        about="the word vectors of the query, without the graph",
        role="knowledge",
        knowledge=_QUERY_WORDS,
        **_GROUNDED,
        colour="c-green",
    ),
    "query-analogy": Agent(
        about="ANALOGY embeddings of the values of the query",
        role="knowledge",
        knowledge=replace(_QUERY_WORDS, source=GraphEmbedding(model="analogy"), centring=False),
        **_GROUNDED,
        colour="c-navy",
    ),
    "query-zeros": Agent(
        about="control of the agents that are told the query: their shape, all zeros",
        role="capacity_control",
        knowledge=replace(QUERY, source=Zeros()),
        **_GROUNDED,
        colour="c-grey",
    ),
    "query-onehot": _control(
        "the agents that are told the query: the index of each condition",
        QUERY,
        OneHot(),
        **_GROUNDED,
        colour="c-teal",
    ),
    "query-random": _control(
        "the agents that are told the query: one random vector per condition",
        QUERY,
        RandomVectors(),
        **_GROUNDED,
        colour="c-purple",
    ),
    "subgraph-shuffled": _control(
        "subgraph: from a graph with permuted tails",
        QUERY,
        ShuffledGraph(),
        **_GROUNDED,
        colour="c-pink",
    ),
}
"""Every agent by name. The first agent of a role stands for it in the demo."""


def first_of_role(role: Role) -> str:
    """Return the name of the first agent in the registry with a role."""
    return next(name for name, agent in AGENTS.items() if agent.role == role)


def controls_of(subject: str, role: Role) -> list[str]:
    """Return the registered controls that match an agent in everything but their purpose.

    A content control has the subject's knowledge but for the source, and the same network; one
    whose numbers depend on no description fits every subject with its scope and slots. A capacity
    control has its scope, slots and width, or no knowledge and as many parameters.

    Args:
        subject: name of a registered agent; others have no registered controls.
        role: of the controls.
    """
    if (agent := AGENTS.get(subject)) is None:
        return []

    def matches(control: Agent) -> bool:
        if replace(control.policy, wide=False) != agent.policy:
            return False
        if control.grounding != agent.grounding:
            return False
        own, other = agent.knowledge, control.knowledge
        if role == "content_control" and replace(other, source=own.source) == own:
            return True
        fields = ["scope", "detail", "dim"]
        if role == "content_control":
            if not other.source.content_free or own.slot_norm is None:
                return False
            fields += ["slot_norm"]
        return all(getattr(other, name) == getattr(own, name) for name in fields)

    return [name for name, each in AGENTS.items() if each.role == role and matches(each)]
