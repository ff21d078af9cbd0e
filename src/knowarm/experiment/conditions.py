"""Test conditions of an evaluation: what the agent is asked, sees and knows in it."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np

from knowarm.config import at_least, fraction
from knowarm.errors import UserError
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.knows import Reasoning, read_known_graph
from knowarm.experiment.other_graphs import (
    answers_before_edit,
    check_graph,
    target_names,
    with_graph,
)
from knowarm.knowledge import KnowledgeGraph
from knowarm.knowledge.graph.damage import Damage, damaged
from knowarm.knowledge.queries.splits import Split
from knowarm.perception.config import LEVEL, Unclear
from knowarm.world.config import EnvConfig, facets_of


@dataclass(frozen=True, kw_only=True)
class Subject:
    """What is evaluated: an environment, and what a trained agent knows in it."""

    env: EnvConfig
    config: ExperimentConfig | None = None
    """What the agent was trained with; None for one that was not trained."""
    graph: KnowledgeGraph | None = None
    """The graph that the agent knows; None for that of its training."""
    reasoning: Reasoning | None = None
    """What it answers queries by; None for what it was trained with."""
    unclear: Unclear = "guess"
    """What it does if it sees no answer, or several."""
    level: float | None = None
    """How often the right object is to be among those that count as answers; None: by name."""

    @property
    def trained(self) -> ExperimentConfig:
        """The config of the trained agent that the condition needs."""
        assert self.config is not None
        return self.config


@dataclass(frozen=True, kw_only=True)
class BaseTest:
    """A condition that differs from training; several apply in their order."""

    changes_agent: ClassVar[bool] = True
    """Whether it changes what a trained agent knows or does, so that others have no use for it."""
    kind: str = ""

    @property
    def label(self) -> str:
        """Its part of the name of the evaluation's folder."""
        return self.kind

    def prepare(self, subject: Subject) -> Subject:
        """Return what is evaluated under this condition."""
        raise NotImplementedError

    def stored(self, env: EnvConfig) -> EnvConfig:
        """Return the environment that was played as the summary stores it."""
        return env

    def columns(self, env: EnvConfig, episodes: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return further columns of the episodes that were played."""
        return {}


@dataclass(frozen=True, kw_only=True)
class HeldOutTest(BaseTest):
    """Play the colours and places that the environment excluded from training."""

    changes_agent: ClassVar[bool] = False
    kind: Literal["held-out"] = "held-out"

    def prepare(self, subject: Subject) -> Subject:
        """Let the environment play what it held out."""
        if subject.env.held_out is None:
            raise UserError(
                "A held-out test plays episodes that were excluded from training, and this "
                "environment holds none out. Train with env.held_out, or leave the test out."
            )
        held_out = replace(subject.env.held_out, play="held_out")
        return replace(subject, env=replace(subject.env, held_out=held_out))


@dataclass(frozen=True, kw_only=True)
class SplitTest(BaseTest):
    """Ask the questions of a split of a task whose questions a graph answers."""

    changes_agent: ClassVar[bool] = False
    kind: Literal["split"] = "split"
    split: Split
    """The split. On S5 an agent knows the edited graph, which also judges it."""
    edited: str | None = None
    """Path of the edited graph of split S5; None takes the one that swaps values."""

    def __post_init__(self) -> None:
        if self.edited is not None and self.split != "S5":
            raise UserError(
                f"edited is the graph of split S5, got split={self.split!r}; set split to 'S5'."
            )

    @property
    def label(self) -> str:
        """The split, and the name of an edited graph."""
        return self.split.lower() + (f"-{Path(self.edited).stem}" if self.edited else "")

    def prepare(self, subject: Subject) -> Subject:
        """Let the task ask the split's questions, and the agent know the edited graph."""
        edited = {} if self.edited is None else {"edited": self.edited}
        env = replace(subject.env, task=subject.env.task.asking(split=self.split, **edited))
        edited_graph = env.task.edited_graph(facets_of(env))
        if edited_graph is None or subject.config is None:
            return replace(subject, env=env)
        check_graph(subject.config, env)
        return replace(subject, env=env, graph=edited_graph)

    def columns(self, env: EnvConfig, episodes: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Where the graph is edited, return whether the chosen object answered before."""
        if env.task.edited_graph(facets_of(env)) is None:
            return {}
        before = answers_before_edit(env)
        asked = zip(episodes["query"], episodes["chosen"], strict=True)
        return {"chose_old_answer": np.array([name in before.get(q, ()) for q, name in asked])}


@dataclass(frozen=True, kw_only=True)
class GraphTest(BaseTest):
    """Ask and answer by another graph: all that it can be asked about objects it describes."""

    kind: Literal["graph"] = "graph"
    graph: str
    """Path of the graph, or the name of a shipped one."""
    names: dict[str, str] = field(default_factory=dict)
    """Its names for objects, where they differ by more than their spelling."""

    @property
    def label(self) -> str:
        """The name of the graph."""
        return Path(self.graph).stem

    def prepare(self, subject: Subject) -> Subject:
        """Let task and agent take the other graph."""
        config = with_graph(subject.trained, self.graph, self.names)
        return replace(subject, env=config.env, config=config)

    def stored(self, env: EnvConfig) -> EnvConfig:
        """Return it with the given graph, not with the cached copy that has the names."""
        return replace(env, task=env.task.asking(graph=self.graph))


@dataclass(frozen=True, kw_only=True)
class DamageTest(BaseTest):
    """Damage the graph that the agent knows, and repair it; the undamaged one judges."""

    kind: Literal["damage"] = "damage"
    damage: Damage | None = None
    """Kind of triples: "missing", "wrong" or "adversarial"; None only repairs."""
    share: float = 0.3
    """Share of the triples about the task's objects that are damaged."""
    seed: int = 0
    """Seed of which triples are damaged, and of the repair."""
    repair: Literal["analogy", "complex"] | None = None
    """Complete the graph by link prediction with this graph embedding, after the damage."""

    def __post_init__(self) -> None:
        at_least(self, 0, "seed", where="damage.")
        fraction(self, "share", where="damage.")

    @property
    def label(self) -> str:
        """Kind and share of the damage, the repair, and a seed that is not 0."""
        parts = [f"{self.damage}-{100 * self.share:g}"] if self.damage else []
        return "-".join([*parts, *filter(None, [self.repair, str(self.seed or "")])])

    def prepare(self, subject: Subject) -> Subject:
        """Let the agent know the damaged and repaired graph."""
        trained, names = subject.trained, target_names(subject.env)
        graph = subject.graph
        if graph is None:
            graph = read_known_graph(trained.knows)
        if graph is None:
            raise UserError(
                f"A damage test changes a graph, and agent {trained.agent!r} has none. Leave it "
                "out."
            )
        if self.damage is not None:
            graph = damaged(graph, self.damage, self.share, self.seed, names)
        if self.repair is not None:
            from knowarm.knowledge.kge.completion import completed  # imports torch

            graph = completed(graph, names, model=self.repair, seed=self.seed)
        return replace(subject, graph=graph)


@dataclass(frozen=True, kw_only=True)
class ReasoningTest(BaseTest):
    """Let an agent with a grounding network answer queries in another way."""

    kind: Literal["reasoning"] = "reasoning"
    by: Reasoning | None = None
    """The query's "vector"; the "graph", while the network only names what stands where; as
    controls of it "graph-shuffled", with permuted tails, or "colours", without facts. None takes
    the agent's own."""
    unclear: Unclear = "guess"
    """What an agent that answers by a graph does if it sees no answer, or several. Nobody answers
    what it asks in an evaluation, so there it stays."""
    level: float | None = None
    """Count an object as an answer if it may be one, so that the right one is counted with this
    probability: calibrated on held-out images. None counts what the network names so, but for
    ``unclear`` "ask", which takes `LEVEL`."""

    @property
    def label(self) -> str:
        """What is answered by, whether the arm stays, and the level."""
        unclear = "" if self.unclear == "guess" else self.unclear
        level = "" if self.level is None else f"level-{100 * self.level:g}"
        return "-".join(filter(None, [self.by, unclear, level]))

    def prepare(self, subject: Subject) -> Subject:
        """Let the agent answer so."""
        level = LEVEL if self.level is None and self.unclear == "ask" else self.level
        return replace(subject, reasoning=self.by, unclear=self.unclear, level=level)


AnyCondition = HeldOutTest | SplitTest | GraphTest | DamageTest | ReasoningTest
