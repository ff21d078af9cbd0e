"""Task: what is asked, and what has to be done."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from knowarm.arrays import Floats, Integers, Mask
from knowarm.config import registered, to_dict
from knowarm.measures import Measure
from knowarm.questions import QuestionTable
from knowarm.world.backend import Dynamics, MujocoSimulator
from knowarm.world.objects.target import Target
from knowarm.world.robots.robot import Robot
from knowarm.world.scene.scene import Scene
from knowarm.world.tasks.asked import ASKED, DEFAULT_ASKED
from knowarm.world.tasks.asked.asked import Asking
from knowarm.world.tasks.asked.nothing import AskNothing
from knowarm.world.tasks.registry import kind_of
from knowarm.world.tasks.sampling import Colours, Facets, ObjectSampler, Setting
from knowarm.world.tasks.skills import DEFAULT_SKILL, SKILLS
from knowarm.world.tasks.skills.guides import Guide
from knowarm.world.tasks.skills.reach import Reach
from knowarm.world.tasks.skills.skill import Skill
from knowarm.world.tasks.skills.teacher import Teacher
from knowarm.world.tasks.state import EpisodeState, NamedArrays

if TYPE_CHECKING:
    from knowarm.knowledge import KnowledgeGraph


@dataclass(frozen=True, kw_only=True)
class Task:
    """What an episode is: a pair of choices that know nothing of each other.

    What is asked decides which objects stand where, which of them is meant, and what a policy is
    told of it. The skill decides how actions move the arm and when the object is reached, lifted
    or lost. All that the library asks of a task is a method here, most of them one of the two's.

    Example:
        >>> Task(asked=AskObject(objects=3), skill=Lift()).name  # doctest: +SKIP
        'choose-lift'
    """

    asked: Asking = field(default_factory=AskNothing, metadata=registered(ASKED.types, "task"))
    """What is asked: ``AskNothing``, ``AskObject``, ``AskPart``, ``AskInstance``, or your own."""
    skill: Skill = field(default_factory=Reach, metadata=registered(SKILLS.types, "task"))
    """What has to be done: ``Reach``, ``Lift``, or a skill of your own."""

    def __post_init__(self) -> None:
        self.skill.check(self.asked)

    @property
    def name(self) -> str:
        """Name in experiments and Gymnasium ids, without what is the default."""
        asked = kind_of(type(self.asked))
        skill = kind_of(type(self.skill))
        if asked == DEFAULT_ASKED:
            return skill
        if skill == DEFAULT_SKILL:
            return asked
        return f"{asked}-{skill}"

    @property
    def title(self) -> str:
        """Words for the task in the titles of a report; none for the paper's."""
        return ", ".join(filter(None, [self.asked.title, self.skill.title]))

    def changes(self) -> dict[str, dict[str, Any]]:
        """Return the fields that differ from the defaults, of what is asked and of the skill."""
        changed: dict[str, dict[str, Any]] = {}
        for name, part in (("asked", self.asked), ("skill", self.skill)):
            standard = to_dict(type(part)())
            values = to_dict(part)
            changed[name] = {key: new for key, new in values.items() if new != standard[key]}
        return changed

    # What is asked.

    @property
    def visible(self) -> int:
        """Number of objects that an episode shows."""
        return self.asked.visible

    @property
    def colours(self) -> Colours | None:
        """Colours of every experiment of the task; None lets ``EnvConfig.colours`` decide."""
        return self.asked.colours

    @property
    def scopes(self) -> frozenset[str]:
        """Scopes of knowledge that describe something in this task."""
        return self.asked.scopes

    @property
    def holds_out(self) -> bool:
        """Whether ``EnvConfig.held_out`` and visual distractors can be combined with the task."""
        return self.asked.holds_out

    @property
    def knowledge_info(self) -> str:
        """Info that names the row of the knowledge table for an episode."""
        return self.asked.knowledge_info

    @property
    def graph(self) -> str | None:
        """Path of the graph that answers the questions, or the name of a shipped one, if any."""
        return self.asked.graph

    @property
    def paints_goal(self) -> bool:
        """Whether the image shows the object that is meant in magenta and the others in grey."""
        return self.asked.paints_goal

    def sampler(self, setting: Setting) -> ObjectSampler:
        """Return what draws the objects of episodes."""
        return self.asked.sampler(setting)

    def questions(self, facets: Facets) -> QuestionTable | None:
        """Return the questions of the task; None if episodes have none."""
        return self.asked.questions(facets)

    def knowledge_rows(self, facets: Facets) -> list[str]:
        """Name the rows of the knowledge table that ``knowledge_info`` refers to."""
        return self.asked.knowledge_rows(facets)

    def knowledge_input(self, state: EpisodeState) -> Integers:
        """Return the row of the knowledge table for each current episode, (n,) int64."""
        return self.asked.knowledge_input(state)

    def asking(self, **fields: Any) -> Self:
        """Return the task with other questions of a graph, by fields of ``GraphQueries``."""
        return replace(self, asked=self.asked.asking(**fields))

    def edited_graph(self, facets: Facets) -> "KnowledgeGraph | None":
        """Return the graph that answers instead of ``graph``, where answers changed; else None."""
        return self.asked.edited_graph(facets)

    def instruct(self, state: EpisodeState, setting: Setting, env_id: int) -> str:
        """Return an episode's goal in words that a policy may know."""
        return self.asked.instruct(state, setting, env_id)

    def describe(self, state: EpisodeState, setting: Setting, env_id: int) -> str:
        """Describe the goal of one episode, as "red mug"."""
        return self.asked.describe(state, setting, env_id)

    # What has to be done.

    @property
    def max_steps(self) -> int:
        """Steps of an episode at most, unless ``EnvConfig.max_episode_steps`` gives others."""
        return self.skill.max_steps

    @property
    def dynamics(self) -> tuple[str, ...]:
        """Values of ``EnvConfig.dynamics`` with which the task can be simulated."""
        return self.skill.dynamics

    @property
    def build_scene(self) -> Callable[[Robot, Sequence[Target], int], Scene]:
        """Builds the scene of a robot, its targets and a number of distractors.

        Scenes are cached by this function, so it is the skill's own.
        """
        return self.skill.build_scene

    def simulator(
        self, scene: Scene, num_envs: int, num_threads: int, dynamics: Dynamics
    ) -> MujocoSimulator:
        """Make the physics of n environments; 0 threads: all cores."""
        return self.skill.simulator(scene, num_envs, num_threads, dynamics)

    def joint_names(self, robot: Robot) -> tuple[str, ...]:
        """Name the joints of the actions of a robot, those of the scene."""
        return self.skill.joint_names(robot)

    def teacher(self, state: EpisodeState) -> Teacher:
        """Make what knows the actions that solve running episodes, for imitation."""
        return self.skill.teacher(state)

    def guide(self, state: EpisodeState, seed: int, straight: bool) -> Guide:
        """Make what guides scripted agents to the solution of running episodes."""
        return self.skill.guide(state, seed, straight)

    def memory(self, num_envs: int) -> NamedArrays:
        """Return the arrays (n, ...) that are remembered between steps, as an episode starts."""
        return self.skill.memory(num_envs)

    def remember(self, state: EpisodeState) -> Mapping[str, NDArray[Any]]:
        """Return the arrays of ``memory`` after a step, new."""
        return self.skill.remember(state)

    def goal(
        self, scene: Scene, objects: Integers, position: Floats, matrix: Floats
    ) -> tuple[Floats, Floats]:
        """Return the frame that the gripper has to reach in k episodes; see `Skill.goal`."""
        return self.skill.goal(scene, objects, position, matrix)

    def success(self, state: EpisodeState) -> Mask:
        """Return which episodes are solved, (n,) bool; a solved one ends."""
        return self.skill.success(state)

    def reward(self, state: EpisodeState) -> Floats:
        """Compute the reward of a step, (n,)."""
        return self.skill.reward(state)

    # Both.

    @property
    def targets(self) -> tuple[str, ...]:
        """Objects of the task unless ``EnvConfig.targets`` names others."""
        names = self.asked.targets or self.skill.targets
        return tuple(filter(self.skill.suits, names))

    @property
    def column_meanings(self) -> dict[str, str]:
        """What each of the ``columns`` holds."""
        return self.asked.column_meanings | self.skill.column_meanings

    @property
    def measures(self) -> tuple[Measure, ...]:
        """Further numbers of an evaluation, computed from its columns."""
        return self.asked.measures + self.skill.measures

    def training(self, algorithm: str) -> tuple[Mapping[str, Any], ...]:
        """Return fields of the task's experiments that differ from an algorithm's defaults.

        Mappings for `knowarm.config.override`, of which a later one counts more.
        """
        return self.asked.training(algorithm), self.skill.training(algorithm, self.asked)

    def area_of(self, robot: Robot) -> str:
        """Return the name of the robot's area in which episodes take place."""
        return self.asked.area or self.skill.area_of(robot)

    def nearest(self, state: EpisodeState) -> Integers:
        """Return which visible object the gripper is at, (n,) int64; 0 is the one that is meant."""
        if self.visible == 1:
            return np.zeros(len(state.steps), dtype=np.int64)
        return self.asked.nearest(state, self.skill.grasp_positions(state))

    def failure(self, state: EpisodeState) -> Mask | None:
        """Return which episodes end without success before the time limit, (n,) bool, or None.

        Otherwise an agent could do it to all visible objects in turn.
        """
        lost = self.skill.failure(state)
        if self.visible == 1:
            return lost
        nearest = self.nearest(state)
        wrong = self.skill.done_to(state, nearest) & (nearest != 0)
        if lost is None:
            return wrong
        return wrong | lost

    def infos(self, state: EpisodeState) -> NamedArrays:
        """Return the infos of the current state, (n, ...) each; ``is_success`` among them."""
        infos = {
            "distance": state.distance,
            "angle": state.angle,
            "target": state.target,
            "colour": state.colours[:, 0],
            "facet": state.facet_names[state.facet],
            "is_success": state.success,
        }
        asked = self.asked.infos(state, self.nearest(state))
        return infos | asked | self.skill.infos(state)

    def columns(self, setting: Setting, infos: NamedArrays) -> NamedArrays:
        """Return further columns of an evaluation's ``episodes.parquet``, (N,) each.

        Args:
            setting: what the episodes were drawn from.
            infos: the infos at the end of N episodes.
        """
        return self.asked.columns(setting, infos) | self.skill.columns(setting, infos)
