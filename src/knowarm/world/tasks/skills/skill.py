"""Skill: how actions move the arm, what counts as success, what ends an episode, and reward."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

from knowarm.arrays import Array, Floats, Floats32, Images, Indices, Integers, Mask
from knowarm.knowledge import KnowledgeGraph
from knowarm.world.backend import Dynamics, MujocoSimulator
from knowarm.world.objects.target import Target
from knowarm.world.robots.robot import Robot
from knowarm.world.scene.scene import Scene, build_scene, target_places
from knowarm.world.tasks.asked.asked import Asking
from knowarm.world.tasks.base_part import BaseTaskPart
from knowarm.world.tasks.reward import is_success, paper_reward
from knowarm.world.tasks.skills.chores import Chores
from knowarm.world.tasks.skills.guides import Guide, Sight, StraightApproach
from knowarm.world.tasks.skills.teacher import Teacher
from knowarm.world.tasks.state import EpisodeState, Frames, NamedArrays


@dataclass(frozen=True, kw_only=True)
class Skill(BaseTaskPart):
    """Base of skills: the arm has to reach the grasp frame of the object that is meant.

    A frozen config; all methods are batched over n episodes. To write your own, derive from this
    class, add a field ``kind`` with a literal tag, override what differs, and select it with
    ``EnvConfig(task=...)`` or ``--env.task package.module:Name``.
    """

    area: ClassVar[str] = "reach"
    """Name in ``Robot.areas`` of the rectangle in which objects stand, unless what is asked names
    one; a robot without an area of this name uses its standard rectangle."""
    targets: ClassVar[tuple[str, ...]] = ("mug", "bottle", "cereal_box")
    """Objects unless ``EnvConfig.targets`` or what is asked names others."""
    max_steps: ClassVar[int] = 50
    """Steps of an episode at most, unless ``EnvConfig.max_episode_steps`` gives others."""
    dynamics: ClassVar[tuple[str, ...]] = ("dynamic", "kinematic")
    """Values of ``EnvConfig.dynamics`` with which it can be simulated."""
    moves_fingers: ClassVar[bool] = False
    """Whether it needs a robot whose fingers move."""
    tells_facts: ClassVar[bool] = False
    """Whether `facts` tells something, by which a graph decides where an object has to be put.

    `see` finds that place, and a policy is told it."""

    @property
    def draws(self) -> int:
        """Number of uniform draws per episode for what else it puts into the scene."""
        return 0

    def check(self, asked: Asking) -> None:
        """Check that it can be done with what is asked.

        Raises:
            UserError: it cannot.
        """

    def suits(self, target: str) -> bool:
        """Return whether it can be done with an object, by name, with the shipped grippers."""
        return True

    def training(self, algorithm: str, asked: Asking) -> Mapping[str, Any]:
        """Return the fields of an experiment that differ from an algorithm's defaults."""
        return {}

    def area_of(self, robot: Robot) -> str:
        """Return the name of the robot's area in which episodes take place.

        Raises:
            UserError: the robot has none, and its standard rectangle does not fit.
        """
        return self.area

    def areas_to_try(self, robot: Robot) -> Iterable[dict[str, Any]]:
        """Yield areas, fields of `Area`, of which a drafted robot gets the one that fits best."""
        return ()

    @classmethod
    def build_scene(
        cls, robot: Robot, targets: Sequence[Target], distractors: int
    ) -> Scene:
        """Build the scene; by default objects have no physics."""
        return build_scene(robot, targets, distractors)

    def simulator(
        self, scene: Scene, num_envs: int, num_threads: int, dynamics: Dynamics
    ) -> MujocoSimulator:
        """Make the physics of n environments with a scene of `build_scene`; 0 threads: all cores.

        Methods of the skill find it in ``EpisodeState.simulator``, where its class is that of
        ``EpisodeState[ItsSimulator]``.
        """
        return MujocoSimulator(scene, num_envs, num_threads, dynamics)

    def joint_names(self, robot: Robot) -> tuple[str, ...]:
        """Name the joints of the actions of a robot, those of the scene."""
        return robot.joints

    def teacher(self, state: EpisodeState) -> Teacher:
        """Make what knows the actions that solve running episodes, for imitation."""
        return Teacher(state)

    def guide(self, straight: bool) -> type[Guide]:
        """Return what guides scripted agents to the solution of running episodes.

        ``straight`` asks for a path that ends straight along the approach direction.
        """
        return StraightApproach if straight else Guide

    def memory(self, num_envs: int) -> NamedArrays:
        """Return the arrays (n, ...) that are remembered between steps, as an episode starts.

        They are stored and restored with the environment, and read from ``EpisodeState.memory``.
        """
        return {}

    def begin(
        self, state: EpisodeState, asked: Asking, ids: Indices, surroundings: Floats
    ) -> NamedArrays:
        """Return the arrays of ``memory`` with which episodes (k,) start, if others than those.

        Args:
            state: the episodes, of which objects, colours, places and question are known.
            asked: what is asked in them.
            ids: numbers of those that start, (k,).
            surroundings: draws in [0, 1), (k, ``draws``).
        """
        return {}

    def paint(self, state: EpisodeState, ids: Indices, rgba: Floats32) -> None:
        """Paint what else it puts into the scene, in the colours of geoms, (k, G, 4) in 0..1."""

    def facts(self, state: EpisodeState, asked: Asking) -> NamedArrays:
        """Return what an agent is given about each episode besides what is asked, (n, ...)."""
        return {}

    def instruct(self, state: EpisodeState, asked: Asking, env_id: int) -> str:
        """Return the same of one episode in words; none by default."""
        return ""

    def result(self, state: EpisodeState, asked: Asking, env_id: int) -> str:
        """Say what became of the object of one episode; empty where reaching it is all."""
        return ""

    def chores(self, state: EpisodeState, asked: Asking) -> Chores | None:
        """Return what there is to do with all objects of scenes that start, or None."""
        return None

    def solved(self, state: EpisodeState, asked: Asking, graph: KnowledgeGraph) -> Mask:
        """Return which episodes are solved by what a graph states, in place of the task's, (n,)."""
        return state.success

    def sent(
        self, state: EpisodeState, asked: Asking, env_id: int, where: str
    ) -> KnowledgeGraph | None:
        """Return the graph by which all objects belong at a place that words name.

        None: there is no such place in the episode.
        """
        return None

    def without_destination(self) -> Self:
        """Return the skill in whose episodes no question names where to put the object."""
        return self

    def swapped(self, facts: Mapping[str, Array]) -> Mapping[str, Array]:
        """Return what replaces some of the `facts` so that objects belong elsewhere: a control."""
        return {}

    def see(
        self,
        scene: Scene,
        sight: Sight,
        images: Images,
        facts: Mapping[str, Array],
        graph: KnowledgeGraph | None,
    ) -> Sight:
        """Add what it reads itself from images (n, H, W, 3) to what a network sees of objects.

        Args:
            scene: robot and objects.
            sight: joint angles and objects.
            images: the first ones of n episodes.
            facts: as by `facts`.
            graph: what the agent knows; None without.
        """
        return sight

    def remember(self, state: EpisodeState) -> Mapping[str, Array]:
        """Return the arrays of ``memory`` after a step, new, with its distance and angle known."""
        return {}

    def goal_frames(self, scene: Scene, objects: Integers, places: Floats) -> Frames:
        """Return the goal frames of objects (k,) at places (k, 2) [m]: (k, 3) [m] and (k, 9)."""
        position = target_places(scene, places) + scene.grasp_position[objects]
        matrix = scene.grasp_matrix[objects].reshape(-1, 9)
        return self.goal(scene, objects, position, matrix)

    def goal(
        self, scene: Scene, objects: Integers, position: Floats, matrix: Floats
    ) -> Frames:
        """Return the frame that the gripper has to reach in k episodes.

        Args:
            scene: robot and objects.
            objects: index of each episode's object, (k,).
            position: its grasp point, world, (k, 3) [m].
            matrix: rotation from its grasp frame to world, row-major, (k, 9).
        """
        return position, matrix

    def grasp_positions(self, state: EpisodeState) -> Floats:
        """Return the grasp points of the visible objects as they are now, world, (n, m, 3) [m]."""
        return state.grasp_positions()

    def done_to(self, state: EpisodeState, which: Integers) -> Mask:
        """Return whether it was done to visible objects (n,), (n,) bool; to a wrong one it is lost.

        By default the goal frame of the object has to be within the thresholds of the config,
        whatever the curriculum's.
        """
        distance, angle = state.measure_object(which)
        return is_success(distance, angle, *state.limits)

    def success(self, state: EpisodeState) -> Mask:
        """Return which episodes are solved, (n,) bool; a solved one ends.

        Where it asks less or more than `done_to`, override both: a wrong object is lost by
        ``done_to``.
        """
        return is_success(state.distance, state.angle, *state.thresholds)

    def failure(self, state: EpisodeState) -> Mask | None:
        """Return which episodes are lost before the time limit, (n,) bool, or None."""
        return None

    def reward(self, state: EpisodeState) -> Floats:
        """Compute the reward of a step, (n,); the paper's by default (table 1)."""
        return paper_reward(state.distance, state.angle, state.success)

    def infos(self, state: EpisodeState) -> NamedArrays:
        """Return further infos of the current state, (n, ...) each."""
        return {}
