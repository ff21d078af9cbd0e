"""Asking: the objects of an episode, which of them is meant, and what a policy is given."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

from knowarm.arrays import Floats, Integers
from knowarm.errors import UserError
from knowarm.questions import QuestionTable
from knowarm.world.tasks.base_part import BaseTaskPart
from knowarm.world.tasks.sampling import (
    Colours,
    Facets,
    ObjectSampler,
    OneObject,
    Setting,
)
from knowarm.world.tasks.state import EpisodeState, NamedArrays

if TYPE_CHECKING:
    from knowarm.knowledge import KnowledgeGraph


@dataclass(frozen=True, kw_only=True)
class Asking(BaseTaskPart):
    """Base of what is asked: nothing, so that the one visible object is meant.

    A frozen config; all methods are batched over n episodes. To write your own, derive from this
    class, add a field ``kind`` with a literal tag, override what differs, and select it with
    ``EnvConfig(task=...)`` or ``--env.task package.module:Name``.
    """

    area: ClassVar[str | None] = None
    """Name in ``Robot.areas`` of the rectangle in which objects stand; None: the skill's."""
    targets: ClassVar[tuple[str, ...]] = ()
    """Objects unless ``EnvConfig.targets`` names others; empty: the skill's."""
    colours: ClassVar[Colours | None] = None
    """Colours of every experiment; None lets ``EnvConfig.colours`` decide."""
    scopes: ClassVar[frozenset[str]] = frozenset({"scene", "target"})
    """Scopes of knowledge that describe something in these episodes."""
    holds_out: ClassVar[bool] = True
    """Whether ``EnvConfig.held_out`` and visual distractors can be combined with it."""
    knowledge_info: ClassVar[str] = "facet"
    """Info that names the row of the knowledge table for an episode."""
    shares_places: ClassVar[bool] = False
    """Whether several targets are one object, at one place."""

    @property
    def visible(self) -> int:
        """Number of objects that an episode shows."""
        return 1

    @property
    def graph(self) -> str | None:
        """Path of the graph that answers the questions, or the name of a shipped one, if any."""
        return None

    @property
    def paints_goal(self) -> bool:
        """Whether the image shows the object that is meant in magenta and the others in grey."""
        return False

    def training(self, algorithm: str) -> Mapping[str, Any]:
        """Return the fields of an experiment that differ from an algorithm's defaults."""
        return {}

    def sampler(self, setting: Setting) -> ObjectSampler:
        """Return what draws the objects of episodes, uniform by default (paper, table 1).

        Raises:
            UserError: the setting does not fit.
        """
        return OneObject(setting)

    def questions(self, facets: Facets) -> QuestionTable | None:
        """Return the questions; None if episodes have none."""
        return None

    def knowledge_rows(self, facets: Facets) -> list[str]:
        """Name the rows of the knowledge table that ``knowledge_info`` refers to."""
        return ["/".join(facet) for facet in facets]

    def knowledge_input(self, state: EpisodeState) -> Integers:
        """Return the row of the knowledge table for each current episode, (n,) int64."""
        return state.facet

    def asking(self, **fields: Any) -> Self:
        """Return the same with other questions of a graph, by fields of ``GraphQueries``.

        Raises:
            UserError: no graph answers questions.
        """
        name, value = next(iter(fields.items()))
        raise UserError(
            f"The task has no queries that a graph could answer, got {name}={value!r}. Take a run "
            f"of a task with such queries, or leave {name} out."
        )

    def edited_graph(self, facets: Facets) -> "KnowledgeGraph | None":
        """Return the graph that answers instead of ``graph``, where answers changed; else None."""
        return None

    def answering_graph(self, facets: Facets) -> "KnowledgeGraph | None":
        """Return the graph that answers the questions, edited or not; None without one."""
        from knowarm.knowledge.formats import read_graph

        edited = self.edited_graph(facets)
        if edited is not None or self.graph is None:
            return edited
        return read_graph(self.graph)

    def nearest(self, state: EpisodeState, points: Floats) -> Integers:
        """Return which of several visible objects the gripper is at, (n,) int64; 0 is meant.

        Args:
            state: the episodes.
            points: grasp points of the visible objects, world, (n, m, 3) [m].
        """
        raise NotImplementedError

    def infos(self, state: EpisodeState, nearest: Integers) -> NamedArrays:
        """Return further infos of the current state, (n, ...) each; ``nearest`` as above."""
        return {}

    def instruct(self, state: EpisodeState, setting: Setting, env_id: int) -> str:
        """Return an episode's goal in words that a policy may know: without the answer to a query.

        Recorded datasets have it as their task.
        """
        return self.describe(state, setting, env_id)

    def describe(self, state: EpisodeState, setting: Setting, env_id: int) -> str:
        """Describe the goal of one episode, as "red mug"."""
        number = state.target[env_id]
        colour = state.scene.colour_names[number][state.colours[env_id, 0]]
        return f"{colour} {state.scene.targets[number].name}"
