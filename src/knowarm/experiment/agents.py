"""Registry of agents: the knowledge and the policy network of each, and its role in a study."""

from dataclasses import dataclass, field, replace
from typing import Literal

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
    colour: str | None = None
    """Class of the report's palette that draws the agent in every chart (``c-blue``); None takes
    a spare one."""


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
        knowledge=replace(FULL, scope="target"),
        colour="c-gold",
    ),
    "target+": Agent(
        about="as target, with the embedding of full+ (privileged)",
        role="privileged",
        knowledge=replace(FULL_PLUS, scope="target"),
    ),
    "target-onehot": Agent(
        about="control of target: the index of the facet, no meaning (privileged)",
        role="content_control",
        knowledge=replace(FULL, source=OneHot(), scope="target"),
    ),
    "zeros": Agent(
        about="control: full's shape, all zeros",
        role="capacity_control",
        knowledge=replace(FULL, source=Zeros()),
        colour="c-grey",
    ),
    "random": Agent(
        about="control: full's shape and norm, random",
        role="content_control",
        knowledge=replace(FULL, source=RandomVectors()),
        colour="c-purple",
    ),
    "shuffled": Agent(
        about="control: full from a graph with permuted tails",
        role="content_control",
        knowledge=replace(FULL, source=ShuffledGraph()),
        colour="c-pink",
    ),
    "onehot": Agent(
        about="control: one-hot slots",
        role="content_control",
        knowledge=replace(FULL, source=OneHot()),
        colour="c-teal",
    ),
    "wrong-object": Agent(
        about="control: each slot describes another object",
        role="content_control",
        knowledge=replace(FULL, source=WrongObject()),
    ),
    "learned": Agent(
        about="control: the vector is learned with the policy",
        role="content_control",
        knowledge=replace(FULL, source=Learned()),
        policy=PolicyConfig(knowledge_encoder="learned"),
    ),
    "wide": Agent(
        about="control: no knowledge, full's LSTM size and parameter count",
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
}
"""Every agent by name. The first agent of a role stands for it in the demo."""


def first_of_role(role: Role) -> str:
    """Return the name of the first agent in the registry with a role."""
    return next(name for name, agent in AGENTS.items() if agent.role == role)
