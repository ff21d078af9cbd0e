"""Asking for an object: several are visible, and one of them answers a query."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal, Self

import numpy as np

from knowarm.arrays import Floats, Integers
from knowarm.config import check_values, override
from knowarm.knowledge import KnowledgeGraph
from knowarm.measures import Measure
from knowarm.questions import AND, QuestionTable
from knowarm.ranges import within
from knowarm.world.tasks.asked.asked import Asking
from knowarm.world.tasks.asked.query.arrangements import SeveralObjects
from knowarm.world.tasks.asked.query.query_source import (
    GraphQueries,
    NameQueries,
    question_table,
)
from knowarm.world.tasks.sampling import Facets, ObjectSampler, Setting
from knowarm.world.tasks.state import EpisodeState, NamedArrays

CHOOSE_TARGETS = (
    "mug",
    "bottle",
    "teapot",
    "kettle",
    "pitcher",
    "wine_glass",
    "bowl",
    "vase",
    "pot",
    "pan",
    "jar",
    "can",
    "candle",
    "lamp",
    "flashlight",
    "mallet",
    "brush",
    "basket",
    "bucket",
    "watering_can",
    "clock",
    "book",
    "toolbox",
    "dumbbell",
    "bell",
    "globe",
)
"""Objects among which is chosen."""

MAX_OBJECTS = 6


@dataclass(frozen=True, kw_only=True)
class AskObject(Asking):
    """Several objects in the rectangle, of which exactly one answers the episode's question."""

    area = "choose"
    targets: ClassVar[tuple[str, ...]] = CHOOSE_TARGETS
    colours = "randomized"
    scopes = frozenset({"query"})
    holds_out = False
    knowledge_info = "query"
    column_meanings: ClassVar[dict[str, str]] = {
        "query": "query of the episode",
        "chosen": "object whose grasp point was nearest to the gripper at the end",
        "choice_correct": "whether that object answers the query",
        "chance": "share of right objects of an agent that picks one at random",
        "query_type": "relations that the query names",
    }
    measures: ClassVar[tuple[Measure, ...]] = (
        Measure("choice", "right choices", "choice_correct"),
        Measure(
            "success_if_chosen",
            "success if chosen rightly",
            "success",
            among="choice_correct",
        ),
    )

    fewest: ClassVar[int] = 1
    """Objects per episode at least."""

    kind: Literal["choose"] = "choose"
    """Tag in JSON."""
    objects: int = 4
    """Objects per episode, 1 to 6, all different; a single one answers its question."""
    queries: GraphQueries | NameQueries = field(default_factory=GraphQueries)
    """Where the questions come from, and which objects answer them."""
    marked: bool = False
    """Paint the object that answers the question in magenta and the others in grey: the upper
    bound of what a query can contribute."""

    def __post_init__(self) -> None:
        check_values(self)
        within(self, self.fewest, MAX_OBJECTS, "objects", where="AskObject.")

    @property
    def title(self) -> str:
        """The kind and the number of objects."""
        return f"{self.kind} among {self.objects}"

    @property
    def visible(self) -> int:
        """Number of objects that an episode shows."""
        return self.objects

    @property
    def graph(self) -> str | None:
        """Path of the graph that answers the questions, or the name of a shipped one, if any."""
        return self.queries.graph_path

    @property
    def paints_goal(self) -> bool:
        """Whether the image shows which object answers the question."""
        return self.marked

    def sampler(self, setting: Setting) -> ObjectSampler:
        """Return what draws objects, places and questions."""
        return SeveralObjects(setting, self.questions(setting.facets), self.visible)

    def questions(self, facets: Facets) -> QuestionTable:
        """Return the questions, cached per process."""
        return question_table(
            self.queries, facets, self.visible, self.queries.version()
        )

    def knowledge_rows(self, facets: Facets) -> list[str]:
        """Name the rows of the knowledge table: one per query."""
        return [query.name for query in self.questions(facets).queries]

    def training(self, algorithm: str) -> Mapping[str, Any]:
        """Train for longer, and let a privileged teacher reward progress."""
        # Without progress_coef, grasps of which few objects are examples are learned late.
        progress = {"privileged": {"progress_coef": 1.0}}
        fields: dict[str, dict[str, Any]] = {
            "fast": {"total_steps": 2_000_000, "algorithm": progress},
            "distil": {"total_steps": 300_000},
        }
        return fields.get(algorithm, {})

    def asking(self, **fields: Any) -> Self:
        """Return the same with other questions of a graph, by fields of ``GraphQueries``."""
        if self.graph is None:
            return super().asking(**fields)
        return replace(self, queries=override(self.queries, fields))

    def edited_graph(self, facets: Facets) -> KnowledgeGraph | None:
        """Return the graph that answers instead of ``graph``, of split S5; else None."""
        return self.queries.edited_graph(facets, self.visible)

    def knowledge_input(self, state: EpisodeState) -> Integers:
        """Return the number of each episode's query, (n,) int64."""
        return state.question

    def nearest(self, state: EpisodeState, points: Floats) -> Integers:
        """Return which visible object's grasp point is nearest to the gripper, (n,) int64."""
        way = points - state.simulator.tcp_position[:, None]
        return np.argmin(np.sum(way * way, axis=2), axis=1)

    def infos(self, state: EpisodeState, nearest: Integers) -> NamedArrays:
        """Return the infos of the choice.

        ``reached_object`` is the object whose grasp point is nearest to the gripper, (n,) int64;
        ``is_right_object``, whether it answers the question, (n,) bool; ``query``, its name, (n,);
        ``objects`` and ``object_colours``, indices of the visible objects and of their colours,
        the right one first, (n, m) int64; ``object_positions``, their x and y, (n, m, 2) [m].
        """
        return {
            "reached_object": state.objects[np.arange(len(nearest)), nearest],
            "is_right_object": nearest == 0,
            "query": state.query_names[state.question],
            "objects": state.objects,
            "object_colours": state.colours,
            "object_positions": state.positions,
        }

    def columns(self, setting: Setting, infos: NamedArrays) -> NamedArrays:
        """Return the query, its relations, the object reached, and whether it answers the query."""
        names = np.array([target.name for target in setting.scene.targets])
        queries = infos["query"]
        relations = {}
        for query in self.questions(setting.facets).queries:
            relations[query.name] = AND.join(part.relation for part in query.conditions)
        return {
            "query": queries,
            "chosen": names[infos["reached_object"]],
            "choice_correct": infos["is_right_object"],
            "chance": np.full(len(queries), 1 / self.visible),
            "query_type": np.array([relations[name] for name in queries]),
        }

    def instruct(self, state: EpisodeState, setting: Setting, env_id: int) -> str:
        """Return the question, as "usedFor drinking"."""
        return str(state.query_names[state.question[env_id]])

    def describe(self, state: EpisodeState, setting: Setting, env_id: int) -> str:
        """Describe the question and its answer, as "usedFor drinking: the red mug"."""
        answer = super().describe(state, setting, env_id)
        return f"{self.instruct(state, setting, env_id)}: the {answer}"
