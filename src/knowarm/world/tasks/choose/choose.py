"""Choose task: several objects are visible, and the arm moves to the one that answers a question.

An episode ends where any of the objects is reached. Otherwise an agent could try all of them in
turn.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from knowarm.arrays import Integers, Mask
from knowarm.config import check_values, override, within
from knowarm.knowledge import KnowledgeGraph
from knowarm.measures import Measure
from knowarm.questions import AND, ObjectColour, QuestionTable
from knowarm.world.objects.families import FAMILIES
from knowarm.world.tasks.choose.arrangements import SeveralObjects, question_table
from knowarm.world.tasks.choose.query_source import GraphQueries, NameQueries
from knowarm.world.tasks.reward import is_success
from knowarm.world.tasks.sampling import Colours, ObjectSampler, Setting
from knowarm.world.tasks.state import EpisodeState
from knowarm.world.tasks.task import Task

CHOOSE_TARGETS = (
    *("mug", "bottle", "teapot", "kettle", "pitcher", "wine_glass", "bowl", "vase", "pot", "pan"),
    *("jar", "can", "candle", "lamp", "flashlight", "mallet", "brush", "basket", "bucket"),
    *("watering_can", "clock", "book", "toolbox", "dumbbell", "bell", "globe"),
)
"""Objects of the choose task."""

MAX_OBJECTS = 6


@dataclass(frozen=True, kw_only=True)
class Choose(Task):
    """Several objects in the rectangle, of which exactly one answers the episode's question."""

    area: ClassVar[str] = "choose"
    targets: ClassVar[tuple[str, ...]] = CHOOSE_TARGETS
    colours: ClassVar[Colours | None] = "randomized"
    scopes: ClassVar[frozenset[str]] = frozenset({"query"})
    holds_out: ClassVar[bool] = False
    knowledge_info: ClassVar[str] = "query"
    # Without progress_coef, grasps of which few objects are examples are learned late.
    training: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "fast": {"total_steps": 2_000_000, "algorithm": {"privileged": {"progress_coef": 1.0}}},
        "distil": {"total_steps": 300_000},
    }
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
            "success_if_chosen", "success if chosen rightly", "success", among="choice_correct"
        ),
    )

    kind: Literal["choose"] = "choose"
    """Tag of this task in JSON."""
    objects: int = 4
    """Objects per episode, 2 to 6, all different."""
    queries: GraphQueries | NameQueries = field(default_factory=GraphQueries)
    """Where the questions come from, and which objects answer them."""
    marked: bool = False
    """Paint the object that answers the question in magenta and the others in grey: the upper
    bound of what a query can contribute."""

    def __post_init__(self) -> None:
        check_values(self)
        within(self, 2, MAX_OBJECTS, "objects", where="Choose.")

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
        return SeveralObjects(setting, self.queries, self.visible)

    def questions(self, facets: tuple[ObjectColour, ...]) -> QuestionTable:
        """Return the questions, cached per process."""
        return question_table(self.queries, facets, self.visible, self.queries.version())

    def knowledge_rows(self, facets: tuple[ObjectColour, ...]) -> list[str]:
        """Name the rows of the knowledge table: one per query."""
        return [query.name for query in self.questions(facets).queries]

    def asking(self, **fields: Any) -> Task:
        """Return the task with other questions of a graph, by fields of ``GraphQueries``."""
        if self.graph is None:
            return super().asking(**fields)
        return replace(self, queries=override(self.queries, fields))

    def edited_graph(self, facets: tuple[ObjectColour, ...]) -> KnowledgeGraph | None:
        """Return the graph that answers instead of ``graph``, of split S5; else None."""
        return self.queries.edited_graph(facets, self.visible)

    def knowledge_input(self, state: EpisodeState) -> Integers:
        """Return the number of each episode's query, (n,) int64."""
        return state.question

    def failure(self, state: EpisodeState) -> Mask:
        """Return whether the gripper has reached an object that does not answer, (n,) bool.

        Its grasp frame has to be within the thresholds of the config, whatever the curriculum's.
        """
        nearest = self.nearest(state)
        distance, angle = state.measure_object(nearest)
        reached = is_success(distance, angle, state.limits[0], state.limits[1])
        return np.asarray(reached & (nearest != 0))

    def nearest(self, state: EpisodeState) -> Integers:
        """Return which visible object's grasp point is nearest to the gripper, (n,) int64."""
        way = state.grasp_positions() - state.simulator.tcp_position[:, None]
        return np.argmin(np.sum(way * way, axis=2), axis=1)

    def infos(self, state: EpisodeState) -> dict[str, NDArray[Any]]:
        """Return the infos of reaching and those of the choice.

        ``reached_object`` is the object whose grasp point is nearest to the gripper, (n,) int64;
        ``is_right_object``, whether it answers the question, (n,) bool; ``query``, its name, (n,);
        ``objects`` and ``object_colours``, indices of the visible objects and of their colours,
        the right one first, (n, m) int64; ``object_positions``, their x and y, (n, m, 2) [m].
        """
        nearest = self.nearest(state)
        return super().infos(state) | {
            "reached_object": state.objects[np.arange(len(nearest)), nearest],
            "is_right_object": nearest == 0,
            "query": state.query_names[state.question],
            "objects": state.objects,
            "object_colours": state.colours,
            "object_positions": state.positions,
        }

    def columns(
        self, setting: Setting, infos: Mapping[str, NDArray[Any]]
    ) -> dict[str, NDArray[Any]]:
        """Return the query, its relations, the object reached, and whether it answers the query."""
        names = np.array([target.name for target in setting.scene.targets])
        queries = self.questions(setting.facets).queries
        kinds = {query.name: AND.join(c.relation for c in query.conditions) for query in queries}
        return {
            "query": infos["query"],
            "chosen": names[infos["reached_object"]],
            "choice_correct": infos["is_right_object"],
            "chance": np.full(len(infos["query"]), 1 / self.visible),
            "query_type": np.array([kinds[name] for name in infos["query"]]),
        }

    def instruct(self, state: EpisodeState, setting: Setting, env_id: int) -> str:
        """Return the question, as "usedFor drinking"."""
        return str(state.query_names[state.question[env_id]])

    def describe(self, state: EpisodeState, setting: Setting, env_id: int) -> str:
        """Describe the question and its answer, as "usedFor drinking: the red mug"."""
        answer = super().describe(state, setting, env_id)
        return f"{self.instruct(state, setting, env_id)}: the {answer}"


@dataclass(frozen=True, kw_only=True)
class Families(Choose):
    """Instances of families, of which exactly one answers the episode's question."""

    targets: ClassVar[tuple[str, ...]] = FAMILIES

    kind: Literal["families"] = "families"  # type: ignore[assignment]
    """Tag of this task in JSON."""
    queries: GraphQueries | NameQueries = field(
        default_factory=partial(GraphQueries, graph="families", hold_out=("S3b", "S3a", "S4", "S2"))
    )
    """Where the questions come from, and which objects answer them."""
