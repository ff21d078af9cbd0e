"""Task: what is asked, and what has to be done."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from knowarm.arrays import Integers, Mask
from knowarm.config import registered, to_dict
from knowarm.measures import Measure
from knowarm.world.robots.robot import Robot
from knowarm.world.tasks.asked import ASKED
from knowarm.world.tasks.asked.asked import Asking
from knowarm.world.tasks.asked.nothing import AskNothing
from knowarm.world.tasks.registry import kind_of, task_name
from knowarm.world.tasks.sampling import Setting
from knowarm.world.tasks.skills import SKILLS
from knowarm.world.tasks.skills.reach import Reach
from knowarm.world.tasks.skills.skill import Skill
from knowarm.world.tasks.state import (
    BOOL,
    NUMBERS,
    EpisodeState,
    NamedArrays,
    returned,
    returned_rows,
)


@dataclass(frozen=True, kw_only=True)
class Task:
    """What an episode is: a pair of choices that know nothing of each other.

    What is asked decides which objects stand where, which of them is meant, and what a policy is
    given. The skill decides how actions move the arm and when the object is reached, lifted or
    lost. The library calls the two parts, and here what follows from both.

    Example:
        >>> Task(asked=AskObject(objects=3), skill=Lift()).name  # doctest: +SKIP
        'choose-lift'
    """

    asked: Asking = field(
        default_factory=AskNothing, metadata=registered(ASKED.types, "task")
    )
    """What is asked: ``AskNothing``, ``AskObject``, ``AskPart``, ``AskInstance``, or your own."""
    skill: Skill = field(
        default_factory=Reach, metadata=registered(SKILLS.types, "task")
    )
    """What has to be done: ``Reach``, ``Lift``, or a skill of your own."""

    def __post_init__(self) -> None:
        self.skill.check(self.asked)

    @property
    def name(self) -> str:
        """Name in experiments and Gymnasium ids, without what is the default."""
        return task_name(kind_of(type(self.asked)), kind_of(type(self.skill)))

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
            changed[name] = {
                key: new for key, new in values.items() if new != standard[key]
            }
        return changed

    def asking(self, **fields: Any) -> Self:
        """Return the task with other questions of a graph, by fields of ``GraphQueries``."""
        return replace(self, asked=self.asked.asking(**fields))

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
        asked = self.asked
        return asked.training(algorithm), self.skill.training(algorithm, asked)

    def area_of(self, robot: Robot) -> str:
        """Return the name of the robot's area in which episodes take place."""
        return self.asked.area or self.skill.area_of(robot)

    def nearest(self, state: EpisodeState) -> Integers:
        """Return which visible object the gripper is at, (n,) int64; 0 is the one that is meant."""
        if self.asked.visible == 1:
            return np.zeros(len(state.steps), np.int64)
        nearest = self.asked.nearest(state, self.skill.grasp_positions(state))
        return returned(self.asked.nearest, nearest, state.steps.shape, NUMBERS)

    def failure(self, state: EpisodeState) -> Mask | None:
        """Return which episodes end without success before the time limit, (n,) bool, or None.

        Otherwise an agent could do it to all visible objects in turn.
        """
        shape = state.steps.shape
        skill = self.skill
        lost = skill.failure(state)
        if lost is not None:
            lost = returned(skill.failure, lost, shape, BOOL)
        if self.asked.visible == 1:
            return lost
        nearest = self.nearest(state)
        done = returned(skill.done_to, skill.done_to(state, nearest), shape, BOOL)
        wrong = done & (nearest != 0)
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
        n = len(state.steps)
        asked = self.asked.infos(state, self.nearest(state))
        infos |= returned_rows(self.asked.infos, asked, n)
        infos |= self.skill.facts(state, self.asked)
        return infos | returned_rows(self.skill.infos, self.skill.infos(state), n)

    def instruct(self, state: EpisodeState, setting: Setting, env_id: int) -> str:
        """Return an episode's goal in words that a policy may know, without the answer."""
        goal = self.asked.instruct(state, setting, env_id)
        return self._with_facts(goal, state, env_id)

    def describe(self, state: EpisodeState, setting: Setting, env_id: int) -> str:
        """Describe the goal of one episode, as "red mug"."""
        goal = self.asked.describe(state, setting, env_id)
        return self._with_facts(goal, state, env_id)

    def _with_facts(self, goal: str, state: EpisodeState, env_id: int) -> str:
        facts = self.skill.instruct(state, self.asked, env_id)
        return "; ".join(filter(None, [goal, facts]))

    def columns(self, setting: Setting, infos: NamedArrays) -> NamedArrays:
        """Return further columns of an evaluation's ``episodes.parquet``, (N,) each.

        Args:
            setting: what the episodes were drawn from.
            infos: the infos at the end of N episodes.
        """
        return self.asked.columns(setting, infos) | self.skill.columns(setting, infos)
