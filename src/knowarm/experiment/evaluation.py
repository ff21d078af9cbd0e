"""What is evaluated: episodes and thresholds, and conditions of the test."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np

from knowarm.config import check_values, file_name, registered
from knowarm.errors import UserError
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.knows import Reasoning, read_known_graph
from knowarm.experiment.minimal_pairs import (
    PairsProbe,
    check_pairs,
)
from knowarm.experiment.other_graphs import (
    answers_before_edit,
    check_graph,
    target_names,
    with_graph,
)
from knowarm.experiment.probes import (
    BlindProbe,
    FilmsProbe,
    StepsProbe,
    probe_types,
)
from knowarm.knowledge import KnowledgeGraph
from knowarm.knowledge.graph.builder import shuffle_tails
from knowarm.knowledge.graph.damage import Damage, damaged
from knowarm.knowledge.queries.splits import Split
from knowarm.measures import Columns
from knowarm.perception.config import LEVEL, Unclear
from knowarm.questions import Query
from knowarm.ranges import MOST_INT, within
from knowarm.seeding import derive_seed
from knowarm.world.config import EnvConfig, facets_of, known_places
from knowarm.world.robots.robot import Robot
from knowarm.world.tasks.probe import BaseProbe
from knowarm.world.tasks.state import NamedArrays

Places = Literal["graph", "shuffled", "unknown"]
"""What an agent that sees knows of where objects belong: a graph, or a control in its place."""

PlacesControl = Literal["shuffled", "unknown", "swapped"]


@dataclass(frozen=True, kw_only=True)
class Subject:
    """What is evaluated: an environment, and what a trained agent knows in it."""

    env: EnvConfig
    config: ExperimentConfig | None = None
    """What the agent was trained with; None for one that was not trained."""
    graph: KnowledgeGraph | None = None
    """The graph that the agent knows; None for that of its training."""
    queries: tuple[Query, ...] | None = None
    """The only queries that it is given, a row each; None for all queries of the task."""
    reasoning: Reasoning | None = None
    """What it answers queries by; None for what it was trained with."""
    unclear: Unclear = "guess"
    """What it does if it sees no answer, or several."""
    level: float | None = None
    """How often the right object is to be among those that count as answers; None: by name."""
    solves: bool = False
    """Whether inverse kinematics act in place of the policy, to the frame that the network sees."""
    places: Places | PlacesControl = "graph"
    """What it knows of where objects belong."""

    @property
    def trained(self) -> ExperimentConfig:
        """The config of the trained agent that the condition needs."""
        assert self.config is not None
        return self.config

    @property
    def known_places(self) -> KnowledgeGraph | None:
        """The graph that says where objects belong; None where that is unknown."""
        graph = self.graph
        if graph is None:
            graph = known_places(self.env)
        return told_places(graph, self.places, self.trained.seed)


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

    def columns(self, env: EnvConfig, episodes: Columns) -> NamedArrays:
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
        return _label(self.split.lower(), Path(self.edited or "").stem)

    def prepare(self, subject: Subject) -> Subject:
        """Let the task ask the split's questions, and the agent know the edited graph."""
        questions: dict[str, str] = {"split": self.split}
        if self.edited is not None:
            questions["edited"] = self.edited
        env = replace(subject.env, task=subject.env.task.asking(**questions))
        subject = replace(subject, env=env)
        edited_graph = _edited_graph(env)
        if edited_graph is None or subject.config is None:
            return subject
        check_graph(subject.config, env)
        return replace(subject, graph=edited_graph)

    def columns(self, env: EnvConfig, episodes: Columns) -> NamedArrays:
        """Where the graph is edited, return whether the chosen object answered before."""
        if _edited_graph(env) is None:
            return {}
        before = answers_before_edit(env)
        chosen = zip(episodes["query"], episodes["chosen"], strict=True)
        is_old = [name in before.get(query, ()) for query, name in chosen]
        return {"chose_old_answer": np.array(is_old)}


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
        check_values(self, where="damage")

    @property
    def label(self) -> str:
        """Kind and share of the damage, the repair, and a seed that is not 0."""
        damage = f"{self.damage}-{100 * self.share:g}" if self.damage else ""
        return _label(damage, self.repair or "", str(self.seed or ""))

    def prepare(self, subject: Subject) -> Subject:
        """Let the agent know the damaged and repaired graph."""
        trained = subject.trained
        names = target_names(subject.env)
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
        return _label(self.by or "", unclear, level)

    def prepare(self, subject: Subject) -> Subject:
        """Let the agent answer so."""
        level = LEVEL if self.level is None and self.unclear == "ask" else self.level
        return replace(subject, reasoning=self.by, unclear=self.unclear, level=level)


@dataclass(frozen=True, kw_only=True)
class SeenTest(BaseTest):
    """Let inverse kinematics act in place of the policy: see the grasp frame, then solve the path.

    It needs joint angles and a kinematic model, without which the policy does.
    """

    kind: Literal["seen"] = "seen"

    def prepare(self, subject: Subject) -> Subject:
        """Let the agent solve."""
        return replace(subject, solves=True)


@dataclass(frozen=True, kw_only=True)
class PlacesTest(BaseTest):
    """Control of where objects belong, for agents of tasks in which a graph says it."""

    kind: Literal["places"] = "places"
    places: PlacesControl
    """Which one: a graph with permuted tails says where objects belong ("shuffled"); nothing does,
    and no question names a destination ("unknown"); or each tray is said to be the place of another
    one ("swapped")."""

    @property
    def label(self) -> str:
        """Its kind, and which control."""
        return _label(self.kind, self.places)

    def prepare(self, subject: Subject) -> Subject:
        """Let the agent know other places, or none."""
        if not subject.env.task.skill.tells_facts:
            raise UserError(
                f"places={self.places!r} is for tasks in which a graph says where objects belong, "
                f"and {subject.env.task.name!r} is none. Leave it out, or take a run of "
                "choose-sort."
            )
        return replace(subject, places=self.places)


def told_places(
    graph: KnowledgeGraph | None, places: Places | PlacesControl, seed: int
) -> KnowledgeGraph | None:
    """Return a graph that says where objects belong, or a control in its place."""
    if places == "unknown" or graph is None:
        return None
    if places in ("graph", "swapped"):
        return graph
    return shuffle_tails(graph, derive_seed(seed, "placebos"))


def _edited_graph(env: EnvConfig) -> KnowledgeGraph | None:
    """Return the graph that answers the questions of a task after an edit, if there is one."""
    return env.task.asked.edited_graph(facets_of(env))


AnyCondition = (
    HeldOutTest
    | SplitTest
    | GraphTest
    | DamageTest
    | ReasoningTest
    | SeenTest
    | PlacesTest
)


def _label(*words: str) -> str:
    """Join the words of a label that there are."""
    return "-".join(filter(None, words))


DISTANCE_M = 0.10
ANGLE_DEG = 17.0
"""Thresholds of success in evaluations of robots that state none."""


@dataclass(frozen=True, kw_only=True)
class EvaluationConfig:
    """Settings of a post-training evaluation (paper section 4.2.4)."""

    episodes: int = 1000
    """Total number of episodes."""
    seed: int = 1_000_003
    """Seed of the fixed episodes; far from training seeds, so that none was trained on."""
    seeds: int = 1
    """Number of seeds that the episodes are drawn from in equal shares: ``seed``, ``seed`` + 1,
    and so on; the paper's analysis of variance takes 30 seeds of 100 episodes."""
    distance_m: float = DISTANCE_M
    """Largest distance of a success [m]. The default stands for the robot's where its description
    states one."""
    angle_deg: float = ANGLE_DEG
    """Largest angle of a success [deg]; the paper's section 4. Its section 3 says 20. The default
    stands for the robot's where that is larger."""
    actions: Literal["greedy", "sampled"] = "greedy"
    """Take the most probable action, or sample one."""
    test: tuple[AnyCondition, ...] = ()
    """Conditions that differ from training, in the order in which they apply."""
    probes: tuple[BaseProbe, ...] = field(
        default=(StepsProbe(), FilmsProbe(), BlindProbe()),
        metadata=registered(probe_types),
    )
    """What is recorded and measured besides the outcome of the episodes."""
    label: str | None = None
    """Name of the folder of the evaluation's files; None takes ``post-training-<actions>`` and the
    labels of ``test`` and ``probes``."""

    def __post_init__(self) -> None:
        check_values(self)
        within(self, 1, MOST_INT, "seeds")
        file_name(self, "label")
        has_graph = any(isinstance(condition, GraphTest) for condition in self.test)
        if has_graph and self.split not in (None, "S1"):
            raise UserError(
                "With another graph everything that it can be asked is a question of S1, got "
                f"split={self.split!r}. Leave split out."
            )
        if self.episodes % self.seeds:
            raise UserError(
                f"{self.episodes} episodes cannot be shared equally by {self.seeds} seeds; give a "
                f"multiple of {self.seeds}."
            )

    @property
    def folder(self) -> str:
        """Name of the folder of the evaluation's files."""
        if self.label:
            return self.label
        conditions = [condition.label for condition in self.test]
        probes = [probe.label for probe in self.probes if probe.label]
        return "-".join([f"post-training-{self.actions}", *conditions, *probes])

    @property
    def split(self) -> Split | None:
        """The split that is asked, or None for the questions of training."""
        for condition in self.test:
            if isinstance(condition, SplitTest):
                return condition.split
        return None

    @property
    def films(self) -> int:
        """Number of episodes, from the first, whose images are kept."""
        counts = [
            probe.episodes for probe in self.probes if isinstance(probe, FilmsProbe)
        ]
        return max(counts, default=0)

    def of_robot(self, robot: Robot) -> "EvaluationConfig":
        """Return the settings with the thresholds of a robot where they are the default ones."""
        distance_m = self.distance_m
        angle_deg = self.angle_deg
        if distance_m == DISTANCE_M and robot.evaluation_distance_m is not None:
            distance_m = robot.evaluation_distance_m
        if angle_deg == ANGLE_DEG and robot.success_angle_deg is not None:
            angle_deg = max(ANGLE_DEG, robot.success_angle_deg)
        return replace(self, distance_m=distance_m, angle_deg=angle_deg)

    def prepare(self, subject: Subject) -> Subject:
        """Return a subject under the conditions and thresholds of the evaluation."""
        for condition in self.test:
            if condition.changes_agent and subject.config is None:
                raise UserError(
                    f"Only trained agents can be evaluated with {condition.kind}. Leave it out, or "
                    "pass a run folder."
                )
            subject = condition.prepare(subject)
        if any(isinstance(probe, PairsProbe) for probe in self.probes):
            check_pairs(subject)
        judged = replace(
            subject.env,
            success_distance_m=self.distance_m,
            success_angle_deg=self.angle_deg,
        )
        return replace(subject, env=judged)

    def stored(self, env: EnvConfig) -> EnvConfig:
        """Return the environment that was played as the summary stores it."""
        for condition in self.test:
            env = condition.stored(env)
        return env
