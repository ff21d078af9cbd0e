"""Base of what an agent can know, and knowing nothing."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple

import numpy as np

from knowarm.errors import UserError
from knowarm.knowledge.config import Scope
from knowarm.policy.config import PolicyConfig
from knowarm.world.config import EnvConfig, facets_of
from knowarm.world.tasks.task import Task

if TYPE_CHECKING:  # These import torch, which reading a config does not need.
    from knowarm.experiment.inputs import KnowledgeInput
    from knowarm.knowledge import Embedding, KnowledgeGraph
    from knowarm.perception.grounding import GroundingNetwork

Reasoning = Literal["vector", "graph", "graph-shuffled", "colours"]
"""What a grounding network is given of a query: its vector; the facets that answer it by the graph;
as controls by a graph with permuted tails, or by the query's colour alone."""

Control = Literal["graph-shuffled", "colours"]
"""A reasoning that is a control of answers by the graph."""


class Known(NamedTuple):
    """What is known in a task."""

    embedding: "Embedding | None"
    """Slots of numbers and their origin; None for nothing."""
    table: np.ndarray
    """(rows, K) float32, one row per facet, or per query."""


class Member:
    """Base of the members of `Knows`: an agent without a grounding network, and without a graph."""

    scope: ClassVar[Scope]
    """What a row of the table describes; see `Scope`."""
    is_grounded: ClassVar[bool] = False
    """Whether the policy receives the grasp frame that a grounding network finds."""
    answers_by_graph: ClassVar[bool] = False
    """Whether that network is given answers of the graph instead of a vector."""

    def fits(self, task: Task) -> bool:
        """Return whether a task has what this describes."""
        return self.scope in ("nothing", *task.scopes)

    def embed(
        self,
        env: EnvConfig,
        run_seed: int,
        *,
        graph: "KnowledgeGraph | None" = None,
        trained: EnvConfig | None = None,
    ) -> Known:
        """Embed what is known in a task.

        Args:
            env: the task.
            run_seed: seed of the training.
            graph: in place of the own graph.
            trained: the task of the training, if another one is tested.
        """
        raise NotImplementedError

    def input_sizes(self, embedded: Known) -> tuple[int, int]:
        """Return the numbers that the policy receives, and in how many equal slots."""
        return 0, 1

    def policy(self, config: PolicyConfig) -> PolicyConfig:
        """Return the choices of a policy that receives this."""
        return config

    @property
    def rank(self) -> int:
        """Place among members by how much of the objects is described; 0 for nothing."""
        return 0

    @property
    def has_content(self) -> bool:
        """Whether there is a vector that is not all zeros."""
        return False

    def read_graph(self) -> "KnowledgeGraph | None":
        """Read the graph; None for nothing."""
        return None

    def is_of_graph(self, graph: str) -> bool:
        """Return whether this is from a graph, or from none."""
        return True

    def check_network(
        self, network: "GroundingNetwork | None", table: np.ndarray | None, agent: str
    ) -> None:
        """Check that the network of a training fits, and its table unless that is None."""

    def train_network(self, env: EnvConfig, run_seed: int, **how: Any) -> "GroundingNetwork | None":
        """Train the network before the policy; ``how`` as `train_grounding`, None if stopped."""
        raise NotImplementedError

    def input(
        self,
        env: EnvConfig,
        run_seed: int,
        table: np.ndarray,
        network: Any,
        *,
        graph: "KnowledgeGraph | None" = None,
        control: Control | None = None,
    ) -> "KnowledgeInput":
        """Return the input of the policy.

        Args:
            env: the task.
            run_seed: seed of the training.
            table: the knowledge table of the task.
            network: the trained network, for members that have one.
            graph: in place of the own graph.
            control: of answers by a graph.
        """
        from knowarm.experiment.inputs import KnowledgeTable

        return KnowledgeTable(table)

    def reasoning_by(self, reasoning: Reasoning | None, agent: str) -> "Member":
        """Return the same knowledge with another reasoning; None keeps the own one."""
        if reasoning is not None:
            raise UserError(
                f"The agent {agent!r} has no grounding network, so reasoning cannot be chosen. "
                "Leave reasoning out, or take a run such as zoo/irb120-choose-subgraph-fast."
            )
        return self


@dataclass(frozen=True, kw_only=True)
class NoKnowledge(Member):
    """Nothing but the image (the paper's baseline)."""

    scope: ClassVar[Scope] = "nothing"
    kind: Literal["nothing"] = "nothing"
    """Tag in JSON."""

    def embed(self, env: EnvConfig, run_seed: int, **how: Any) -> Known:
        """As `Member.embed`."""
        rows = len(env.task.knowledge_rows(facets_of(env)))
        return Known(None, np.zeros((rows, 0), np.float32))

    def policy(self, config: PolicyConfig) -> PolicyConfig:
        """As `Member.policy`: it has no fusion."""
        return replace(config, fusion="none")
