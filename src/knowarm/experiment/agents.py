"""Registry of agents: the knowledge and the policy network of each, and its role in a study."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal

from knowarm.experiment.knows import Grounded, Knows, NoKnowledge, Vector
from knowarm.knowledge import FULL, FULL_PLUS, QUERY
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
from knowarm.perception.config import GroundingConfig
from knowarm.policy.config import PolicyConfig

Role = Literal[
    "baseline", "knowledge", "capacity_control", "content_control", "privileged"
]
"""Purpose of an agent in a comparison:

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
    """Purpose in a comparison; reports and their verdicts depend on it."""
    knows: Knows
    """What the agent knows, and what computes it."""
    policy: PolicyConfig = field(default_factory=PolicyConfig)
    """Choices of the policy network."""
    asked: Mapping[str, Any] = field(default_factory=dict)
    """Fields of what is asked that have other values; only tasks with these have the agent."""
    asks: tuple[str, ...] = ()
    """Kinds of what is asked in its experiments; empty for all that its knowledge fits."""
    colour: str | None = None
    """Class of the report's palette that draws the agent in every chart (``c-blue``); None takes
    a spare one."""


def _agent(role: Role, about: str, knows: Knows, **fields: Any) -> Agent:
    return Agent(role=role, about=about, knows=knows, **fields)


_subject = partial(_agent, "knowledge")
_privileged = partial(_agent, "privileged")


def _control(about: str, knows: Any, source: Placebo, **fields: Any) -> Agent:
    """Return a content control: all choices but the source stay, so that the shape is equal."""
    return _agent(
        "content_control",
        f"control of {about}",
        replace(knows, source=source),
        **fields,
    )


def _zeros(about: str, knows: Any, **fields: Any) -> Agent:
    """Return a capacity control whose vector is zero."""
    about = f"control of {about}, all zeros"
    return _agent("capacity_control", about, replace(knows, source=Zeros()), **fields)


def _fused(subject: str, knows: Knows, **how: str) -> dict[str, Agent]:
    """Return agents with a subject's knowledge, the baseline's LSTM size and other fusions."""
    return {
        f"{subject}-{fusion.replace('_', '-')}": _subject(
            f"as {subject}, {about}",
            knows,
            policy=PolicyConfig(fusion=fusion, hidden="fixed"),
        )
        for fusion, about in how.items()
    }


_FULL = Vector(**vars(FULL))
_FULL_PLUS = Vector(**vars(FULL_PLUS))
_TARGET = replace(_FULL, kind="target")
_TARGET_PLUS = replace(_FULL_PLUS, kind="target")
_QUERY = Vector(kind="query", **vars(QUERY))
_GROUNDED = Grounded(**vars(QUERY))
_WORDS = replace(_GROUNDED, hops=0, colour_share=None)
_ANSWERS = replace(
    _GROUNDED, kind="answers", grounding=GroundingConfig(naming_coef=1.0)
)
_ANALOGY = GraphEmbedding(model="analogy")
_HOW = {
    "before_fc": "concatenated before the fully connected layer",
    "after_lstm": "concatenated after the LSTM",
    "film": "scaling and shifting the convolution features",
    "attention": "with attention over its slots",
}
_FIXED = PolicyConfig(hidden="fixed")

AGENTS: dict[str, Agent] = {
    "bm": _agent(
        "baseline",
        "baseline: no knowledge (paper)",
        NoKnowledge(),
        colour="c-orange",
    ),
    "full": _subject("object types and colours (paper)", _FULL, colour="c-blue"),
    "partial": _subject(
        "object types only (paper)", replace(_FULL, detail="partial"), colour="c-green"
    ),
    "full+": _subject(
        "as full, with an embedding that keeps facets apart",
        _FULL_PLUS,
        colour="c-navy",
    ),
    "analogy": _subject(
        "as full, from ANALOGY embeddings (the paper's first choice)",
        replace(_FULL, source=_ANALOGY, relation_words=False),
    ),
    "target": _privileged(
        "the slot of the episode's own object and colour (privileged)",
        _TARGET,
        colour="c-gold",
    ),
    "target+": _privileged(
        "as target, with the embedding of full+ (privileged)", _TARGET_PLUS
    ),
    "target-zeros": _zeros("target and target+: their shape", _TARGET),
    "target-random": _control(
        "target: one random vector per facet", _TARGET, RandomVectors()
    ),
    "target-shuffled": _control(
        "target: from a graph with permuted tails", _TARGET, ShuffledGraph()
    ),
    "target-onehot": _control(
        "target: the index of the facet, no meaning", _TARGET, OneHot()
    ),
    "target-random+": _control(
        "target+, as target-random", _TARGET_PLUS, RandomVectors()
    ),
    "target-shuffled+": _control(
        "target+, as target-shuffled", _TARGET_PLUS, ShuffledGraph()
    ),
    "target-onehot+": _control("target+, as target-onehot", _TARGET_PLUS, OneHot()),
    "zeros": _zeros("full and full+: their shape", _FULL, colour="c-grey"),
    "random": _control(
        "full: its shape and norm, random", _FULL, RandomVectors(), colour="c-purple"
    ),
    "shuffled": _control(
        "full: from a graph with permuted tails",
        _FULL,
        ShuffledGraph(),
        colour="c-pink",
    ),
    "onehot": _control("full: one-hot slots", _FULL, OneHot(), colour="c-teal"),
    "random+": _control("full+, as random", _FULL_PLUS, RandomVectors()),
    "shuffled+": _control("full+, as shuffled", _FULL_PLUS, ShuffledGraph()),
    "onehot+": _control("full+, as onehot", _FULL_PLUS, OneHot()),
    "wrong-object": _control(
        "full: each slot describes another object", _FULL, WrongObject()
    ),
    "learned": _agent(
        "content_control",
        "control: the vector is learned with the policy",
        replace(_FULL, source=Learned()),
        policy=PolicyConfig(knowledge_encoder="learned"),
    ),
    "wide": _agent(
        "capacity_control",
        "control: no knowledge, full's parameter count in a larger LSTM",
        _FULL,
        policy=PolicyConfig(wide=True),
        colour="c-brown",
    ),
    **{
        f"lstm-{size}": _agent(
            "capacity_control",
            f"control: no knowledge, an LSTM of {size}",
            NoKnowledge(),
            policy=PolicyConfig(hidden=size),
        )
        for size in (192, 278, 428)
    },
    "full-fixed": _subject("full with the baseline's LSTM size", _FULL, policy=_FIXED),
    **_fused("full", _FULL, **_HOW, critic="for the critic only"),
    "mask": _privileged(
        "upper bound of the choose task: the image marks the wanted object",
        replace(_GROUNDED, source=Zeros()),
        policy=_FIXED,
        asked={"marked": True},
        colour="c-gold",
    ),
    "subgraph": _subject(
        "the subgraph around the values of the query",
        _GROUNDED,
        policy=_FIXED,
        colour="c-blue",
    ),
    **_fused(
        "subgraph",
        _QUERY,
        **{
            name: f"{about}, without a grounding network"
            for name, about in _HOW.items()
        },
        before_lstm="concatenated before the LSTM as in the paper, without a grounding network",
        similarity="weighting places by similarity, without a grounding network",
    ),
    "query-words": _subject(
        "the word vectors of the query, without the graph",
        _WORDS,
        policy=_FIXED,
        colour="c-green",
    ),
    "query-analogy": _subject(
        "ANALOGY embeddings of the values of the query",
        replace(_WORDS, source=_ANALOGY, centring=False),
        policy=_FIXED,
        # The graph of the purpose task has no colours and objects to embed
        asks=("choose",),
        colour="c-navy",
    ),
    "query-zeros": _zeros(
        "agents with knowledge of the query: their shape",
        _GROUNDED,
        policy=_FIXED,
        colour="c-grey",
    ),
    "query-onehot": _control(
        "agents with knowledge of the query: the index of each condition",
        _GROUNDED,
        OneHot(),
        policy=_FIXED,
        colour="c-teal",
    ),
    "query-random": _control(
        "agents with knowledge of the query: one random vector per condition",
        _GROUNDED,
        RandomVectors(),
        policy=_FIXED,
        colour="c-purple",
    ),
    "subgraph-shuffled": _control(
        "subgraph: from a graph with permuted tails",
        _GROUNDED,
        ShuffledGraph(),
        policy=_FIXED,
        colour="c-pink",
    ),
    "answers": _subject(
        "the graph answers the query, and the network finds the answer by its name",
        _ANSWERS,
        policy=_FIXED,
        colour="c-brown",
    ),
    "answers-shuffled": _control(
        "answers: from a graph with permuted tails",
        _ANSWERS,
        ShuffledGraph(),
        policy=_FIXED,
    ),
}
"""Every agent by name. The first agent of a role stands for it in the demo."""


def first_of_role(role: Role) -> str:
    """Return the name of the first agent in the registry with a role."""
    return next(name for name, agent in AGENTS.items() if agent.role == role)


def controls_of(subject: str, role: Role) -> list[str]:
    """Return the registered controls of a role that match a registered agent but for their purpose.

    A content control has the subject's knowledge but for the source, and the same network; one
    whose numbers depend on no description fits every subject with its kind and slots. A capacity
    control has its kind, slots and width, or no knowledge and as many parameters.
    """
    agent = AGENTS.get(subject)
    if agent is None:
        return []

    def matches(control: Agent) -> bool:
        policy = replace(control.policy, wide=False)
        knows: Any = agent.knows
        control_knows: Any = control.knows
        if policy != agent.policy or knows.kind != control_knows.kind:
            return False
        fields = ["detail", "dim", "grounding"]
        if role == "content_control":
            if replace(control_knows, source=knows.source) == knows:
                return True
            if not control_knows.source.content_free or knows.slot_norm is None:
                return False
            fields.append("slot_norm")
        return all(
            getattr(control_knows, name) == getattr(knows, name) for name in fields
        )

    return [
        name for name, other in AGENTS.items() if other.role == role and matches(other)
    ]
