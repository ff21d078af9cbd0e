"""What an agent knows: nothing, vectors from a graph, or what a network finds in the image.

`NoKnowledge`, `Vector` and `Grounded` are configs, told apart by ``kind``. Each computes a
`Knowledge`, the input of a policy in training and tests.
"""

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from itertools import compress
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from knowarm.errors import UserError
from knowarm.knowledge import (
    Embedding,
    KnowledgeConfig,
    KnowledgeGraph,
    query_embedding,
    read_graph,
    scene_embedding,
)
from knowarm.knowledge.config import Scope
from knowarm.knowledge.graph.builder import shuffle_tails
from knowarm.knowledge.graph.individuals import meant
from knowarm.knowledge.queries.queries import QueryGraph
from knowarm.perception.config import GroundingConfig, seen_width
from knowarm.questions import ObjectColour, Query, QuestionTable
from knowarm.seeding import derive_seed
from knowarm.world.config import (
    EnvConfig,
    facets_of,
    known_places,
    questions_of,
    row_names,
)
from knowarm.world.tasks.task import Task

if TYPE_CHECKING:  # These import torch, which reading a config does not need.
    from knowarm.perception.grounding import GroundingNetwork
    from knowarm.perception.recognition import FrameRecognition
    from knowarm.perception.solving import SeeingAgent
    from knowarm.policy import Policy, PolicyAgent
    from knowarm.world.envs.torch_env import TorchArmVectorEnv

Reasoning = Literal["vector", "graph", "graph-shuffled", "colours"]
"""What a grounding network is given of a query: its vector; the facets that answer it by the graph;
as controls by a graph with permuted tails, or by the query's colour alone."""


@dataclass(frozen=True)
class Knowledge:
    """What an agent knows in a task: the input of its policy in training and tests.

    A policy receives the row of the table that describes the episode. With a grounding network it
    receives the grasp frame that the network finds by that row in the first image.
    """

    table: np.ndarray = field(repr=False)
    """(rows, K) float32, one row per `Task.knowledge_rows`; K may be 0."""
    embedding: Embedding | None = None
    """Where the table is from; None for nothing, and for a table that a run folder keeps."""
    seen_width: int = 0
    """Numbers that the policy receives of what a network sees; 0 without one."""
    recognition: "FrameRecognition | None" = None
    """What finds it; None until the grounding network is trained."""

    @property
    def is_grounded(self) -> bool:
        """Whether the policy receives what a network sees."""
        return self.seen_width > 0

    @property
    def width(self) -> int:
        """Numbers that the policy receives."""
        return self.seen_width or self.table.shape[1]

    @property
    def slots(self) -> int:
        """Number of equal parts of these numbers."""
        if self.is_grounded or self.embedding is None:
            return 1
        return self.embedding.slots_per_row

    def unread(self) -> "Knowledge":
        """Return the knowledge of a policy that reads no vector; a grounding network still does."""
        if self.is_grounded:
            return self
        return replace(self, table=self.table[:, :0])

    def make_env(
        self,
        config: EnvConfig,
        num_envs: int,
        num_threads: int = 0,
        **options: Any,
    ) -> "TorchArmVectorEnv":
        """Make training environments with this knowledge; options as `TorchArmVectorEnv`."""
        from knowarm.perception.recognition import PerceivingVectorEnv
        from knowarm.world.envs.torch_env import TorchArmVectorEnv

        options["num_threads"] = num_threads
        if self.recognition is not None:
            return PerceivingVectorEnv(config, num_envs, self.recognition, **options)
        return TorchArmVectorEnv(config, num_envs, table=self.table, **options)

    def make_agent(self, policy: "Policy", **options: Any) -> "PolicyAgent":
        """Make an agent with this knowledge; options as the agent's class."""
        from knowarm.policy import PolicyAgent

        if self.recognition is not None:
            return self.recognition.make_agent(policy, **options)
        return PolicyAgent(policy, self.table, **options)

    def make_player(
        self, env: EnvConfig, policy: "Policy", **options: Any
    ) -> "PolicyAgent | SeeingAgent":
        """Make what acts with this knowledge and a policy in a task; options as `make_agent`."""
        from knowarm.perception.solving import player

        agent = self.make_agent(policy, **options)
        return player(agent, env, known_places(env), solves=False)


@dataclass(frozen=True, kw_only=True)
class NoKnowledge:
    """Nothing but the image (the paper's baseline)."""

    scope: ClassVar[Scope] = "nothing"
    """What a row of the table describes."""
    rank: ClassVar[int] = 0
    """Place among configs by how much of the objects is described."""
    has_content: ClassVar[bool] = False
    """There is no vector."""
    grounding: ClassVar[None] = None
    """There is no grounding network."""
    kind: Literal["nothing"] = "nothing"
    """Tag in JSON."""

    def known(self, env: EnvConfig, run_seed: int, **options: Any) -> Knowledge:
        """Return a table without columns; the options of the others do not matter."""
        return Knowledge(np.zeros((len(row_names(env)), 0), np.float32))


@dataclass(frozen=True, kw_only=True)
class _Embedded(KnowledgeConfig):
    """Vectors from a graph: of the scene of a task, or of its queries, a slot per condition."""

    def known(
        self,
        env: EnvConfig,
        run_seed: int,
        *,
        table: np.ndarray | None = None,
        graph: KnowledgeGraph | None = None,
        trained: EnvConfig | None = None,
        queries: tuple[Query, ...] | None = None,
        **of_network: Any,
    ) -> Knowledge:
        """Embed what is known in a task.

        Args:
            env: the task.
            run_seed: seed of the training.
            table: in place of embedding anything, the knowledge table of the task.
            graph: in place of the own graph.
            trained: the task of the training, if another one is tested.
            queries: what alone is asked, a row each; None: all queries of the task.
            of_network: arguments of `Grounded.known`, which do not matter here.
        """
        if table is not None:
            return Knowledge(table)
        if self.scope == "query":
            queries = queries or asked(env).queries
            trained_on = asked(trained or env).queries
            of_queries = query_embedding(
                self, queries, run_seed=run_seed, graph=graph, trained_on=trained_on
            )
            return Knowledge(of_queries.table(queries), of_queries)
        facets = facets_of(env)
        embedding = scene_embedding(self, facets, run_seed=run_seed, graph=graph)
        return Knowledge(embedding.table(facets), embedding)


@dataclass(frozen=True, kw_only=True)
class Vector(_Embedded):
    """A vector from a graph, which enters the policy."""

    grounding: ClassVar[None] = None
    """There is no grounding network."""
    kind: Literal["scene", "target", "query"] = "scene"
    """What it describes: "scene" all objects of the task, the same in every episode (the paper's);
    "target" the episode's own object and colour, which no camera saw (privileged); "query" the
    query of the episode."""

    @property
    def scope(self) -> Scope:
        """What a row of the table describes."""
        return self.kind


@dataclass(frozen=True, kw_only=True)
class Grounded(_Embedded):
    """Grasp frame of the object that a network finds in the image, in tasks with queries."""

    kind: Literal["grounded", "answers"] = "grounded"
    """What it is found by: "grounded" the vector of the query; "answers" its name, which the graph
    gives as an answer to the query."""
    grounding: GroundingConfig = field(default_factory=GroundingConfig)
    """Training of the network, before the policy's."""

    @property
    def scope(self) -> Scope:
        """What a row of the table describes."""
        return "query"

    def known(
        self,
        env: EnvConfig,
        run_seed: int,
        *,
        network: "GroundingNetwork | None" = None,
        reasoning: Reasoning | None = None,
        **sources: Any,
    ) -> Knowledge:
        """Embed the queries of a task; with a network, find grasp frames by them.

        Args:
            env: the task.
            run_seed: seed of the training.
            network: the trained network.
            reasoning: which control of the answers of the graph it is, if any.
            **sources: further arguments, as of `Vector.known`.
        """
        knowledge = super().known(env, run_seed, **sources)
        knowledge = replace(knowledge, seen_width=seen_width(env))
        if network is None:
            return knowledge
        from knowarm.perception.recognition import AnswerGrounding, FrameRecognition

        if self.kind == "grounded":
            recognition = FrameRecognition(network, knowledge.table)
            return replace(knowledge, recognition=recognition)
        graph = sources.get("graph")
        facets = network.spec.facets
        options = {"graph": graph, "queries": sources.get("queries")}
        answers = self.answers(env, run_seed, facets, reasoning=reasoning, **options)
        return replace(knowledge, recognition=AnswerGrounding(network, answers))

    def answers(
        self,
        env: EnvConfig,
        run_seed: int,
        facets: tuple[ObjectColour, ...],
        *,
        graph: KnowledgeGraph | None = None,
        queries: tuple[Query, ...] | None = None,
        reasoning: Reasoning | None = None,
    ) -> np.ndarray:
        """Return the probability that each of F facets answers each query of a task, or some.

        It is 0 or 1, but for triples with a confidence. Objects that the graph does not describe
        never answer.

        Returns:
            (Q, F) float32.
        """
        if graph is None:
            graph = read_graph(self.graph)
        draw_seed = self.source.draw_seed(self.seed, run_seed)
        graph = self.source.change_graph(graph, draw_seed)
        queries = queries or asked(env).queries
        if reasoning == "graph-shuffled":
            graph = shuffle_tails(graph, derive_seed(run_seed, "placebos"))
        elif reasoning == "colours":  # no facts are known: only a colour restricts
            queries = tuple(map(_seen_part, queries))
        is_known = described(graph, [name for name, _ in facets])
        answers = np.zeros((len(queries), len(facets)), np.float32)
        known = QueryGraph(graph, compress(facets, is_known))
        answers[:, is_known] = known.degrees(queries)
        return answers


Knows = NoKnowledge | Vector | Grounded
"""What an agent knows, told apart by ``kind``."""


def _seen_part(query: Query) -> Query:
    """Return a query with the conditions alone that an image shows, without a graph."""
    is_seen = [condition.is_seen for condition in query.conditions]
    return Query(tuple(compress(query.conditions, is_seen)))


def fits(knows: Knows, task: Task) -> bool:
    """Return whether a task has what this describes."""
    return knows.scope in ("nothing", *task.asked.scopes)


def answers_by_graph(knows: Knows) -> bool:
    """Return whether a graph answers the queries, so that every task is asked anew."""
    return isinstance(knows, Grounded) and knows.kind != "grounded"


def reason_by(knows: Knows, reasoning: Reasoning | None, agent: str) -> Knows:
    """Return the same knowledge with another reasoning; None keeps the own one."""
    if reasoning is None:
        return knows
    if not isinstance(knows, Grounded):
        raise UserError(
            f"The agent {agent!r} has no grounding network, so reasoning cannot be chosen. "
            "Leave reasoning out, or take a run such as zoo/irb120-choose-answers-fast."
        )
    return replace(knows, kind="grounded" if reasoning == "vector" else "answers")


def read_known_graph(knows: Knows) -> KnowledgeGraph | None:
    """Read the graph that an agent knows; None for nothing."""
    if isinstance(knows, NoKnowledge):
        return None
    return read_graph(knows.graph)


def asked(env: EnvConfig) -> QuestionTable:
    """Return the questions of a task, which must have some."""
    table = questions_of(env)
    if table is None:
        raise UserError(
            f"The task {env.task.name!r} has no queries that a graph could answer. Take a run "
            "of the choose task."
        )
    return table


def described(graph: KnowledgeGraph, names: Collection[str]) -> list[bool]:
    """Return which names a graph describes, by themselves or by individuals."""
    described_as = meant(graph, names, {})
    return [name in described_as for name in names]
