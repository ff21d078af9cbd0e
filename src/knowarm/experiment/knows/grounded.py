"""Knowledge as a grasp frame, which a network finds by a vector or by a graph's answers."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from knowarm.errors import UserError
from knowarm.experiment.answers import answers_by
from knowarm.experiment.knows.member import Control, Known, Reasoning
from knowarm.experiment.knows.vectors import AboutQueries
from knowarm.knowledge import KnowledgeGraph
from knowarm.knowledge.graph.builder import shuffle_tails
from knowarm.perception.config import GroundingConfig
from knowarm.questions import ObjectColour
from knowarm.seeding import derive_seed
from knowarm.world.config import EnvConfig

if TYPE_CHECKING:  # These import torch, which reading a config does not need.
    from knowarm.experiment.inputs import KnowledgeInput
    from knowarm.perception.grounding import GroundingNetwork


@dataclass(frozen=True, kw_only=True)
class Grounded(AboutQueries):
    """Base of the members whose policy receives the grasp frame that a network finds."""

    is_grounded: ClassVar[bool] = True
    grounding: GroundingConfig = field(default_factory=GroundingConfig)
    """Training of the network, before the policy's."""

    def input_sizes(self, embedded: Known) -> tuple[int, int]:
        """As `Member.input_sizes`: those of a grasp frame."""
        from knowarm.perception.grounding import FRAME

        return FRAME, 1

    def train_network(self, env: EnvConfig, run_seed: int, **how: Any) -> "GroundingNetwork | None":
        """As `Member.train_network`."""
        from knowarm.perception.grounding_training import train_grounding

        embedded = self.embed(env, run_seed)
        assert embedded.embedding is not None
        slots = embedded.embedding.slots_per_row
        return train_grounding(env, embedded.table, slots, self.grounding, seed=run_seed, **how)

    def reasoning_by(self, reasoning: Reasoning | None, agent: str) -> "Grounded":
        """As `Member.reasoning_by`."""
        if reasoning is None:
            return self
        kind = GroundedVector if reasoning == "vector" else GraphAnswers
        return kind(**{name: value for name, value in vars(self).items() if name != "kind"})


@dataclass(frozen=True, kw_only=True)
class GroundedVector(Grounded):
    """Grasp frame of the object that a network finds in the image by the vector of the query."""

    kind: Literal["grounded"] = "grounded"
    """Tag in JSON."""

    def check_network(self, network: Any, table: np.ndarray | None, agent: str) -> None:
        """As `Member.check_network`: a network was trained with the same vectors."""
        if network is None or table is None:
            return
        if not np.array_equal(network.knowledge.numpy(), table):
            raise UserError(
                "The given grounding network was trained with other knowledge of the queries than "
                f"the agent {agent!r} has. Give one of the same agent and graph, or leave "
                "perception out."
            )

    def input(
        self, env: EnvConfig, run_seed: int, table: np.ndarray, network: Any, **how: Any
    ) -> "KnowledgeInput":
        """As `Member.input`."""
        from knowarm.perception.agent import FrameRecognition

        return FrameRecognition(network, table)


@dataclass(frozen=True, kw_only=True)
class GraphAnswers(Grounded):
    """Grasp frame of what answers the query by the graph, and a network finds by its name."""

    answers_by_graph: ClassVar[bool] = True
    kind: Literal["answers"] = "answers"
    """Tag in JSON."""

    def answers(
        self,
        env: EnvConfig,
        run_seed: int,
        facets: tuple[ObjectColour, ...],
        *,
        graph: KnowledgeGraph | None = None,
        control: Control | None = None,
    ) -> np.ndarray:
        """Return how probably F facets answer each query by the graph, (Q, F); see `input`."""
        graph = self.read_graph() if graph is None else graph
        graph = self.source.change_graph(graph, self.source.draw_seed(self.seed, run_seed))
        if control == "graph-shuffled":
            graph = shuffle_tails(graph, derive_seed(run_seed, "placebos"))
        return answers_by(graph, env, facets, colours_only=control == "colours")

    def input(
        self, env: EnvConfig, run_seed: int, table: np.ndarray, network: Any, **how: Any
    ) -> "KnowledgeInput":
        """As `Member.input`."""
        from knowarm.perception.answering import AnswerGrounding

        return AnswerGrounding(network, self.answers(env, run_seed, network.spec.facets, **how))
