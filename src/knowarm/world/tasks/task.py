"""Task: what an episode is, what counts as success, what ends an episode, reward and infos."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, get_args, get_type_hints

from numpy.typing import NDArray

from knowarm.arrays import Floats, Integers, Mask
from knowarm.errors import UserError
from knowarm.measures import Measure
from knowarm.questions import ObjectColour, QuestionTable
from knowarm.world.backend import Dynamics, MujocoSimulator
from knowarm.world.objects.target import Target
from knowarm.world.robots.robot import Robot
from knowarm.world.scene.scene import Scene, build_scene
from knowarm.world.tasks.guides import Guide, ShortestWay, StraightApproach
from knowarm.world.tasks.reward import is_success, paper_reward
from knowarm.world.tasks.sampling import Colours, ObjectSampler, OneObject, Setting
from knowarm.world.tasks.state import EpisodeState
from knowarm.world.tasks.teacher import Teacher

if TYPE_CHECKING:
    from knowarm.knowledge import KnowledgeGraph


@dataclass(frozen=True, kw_only=True)
class Task:
    """Base of tasks: one object is visible, and the arm has to reach its grasp frame.

    A task is a frozen config; all methods are batched over n episodes. To write your own, derive
    from this class, add a field ``kind`` with a literal tag, override what differs, and select it
    with ``EnvConfig(task=...)`` or ``--env.task package.module:Name``.
    """

    area: ClassVar[str] = "reach"
    """Name in ``Robot.areas`` of the rectangle in which objects stand; a robot without an area of
    this name uses its standard rectangle. `area_of` can decide otherwise."""
    targets: ClassVar[tuple[str, ...]] = ("mug", "bottle", "cereal_box")
    """Objects of the task unless ``EnvConfig.targets`` names others."""
    colours: ClassVar[Colours | None] = None
    """Colours of every experiment of the task; None lets ``EnvConfig.colours`` decide."""
    max_steps: ClassVar[int] = 50
    """Steps of an episode at most, unless ``EnvConfig.max_episode_steps`` gives others."""
    scopes: ClassVar[frozenset[str]] = frozenset({"scene", "target"})
    """Scopes of knowledge that describe something in this task."""
    holds_out: ClassVar[bool] = True
    """Whether ``EnvConfig.held_out`` and visual distractors can be combined with the task."""
    dynamics: ClassVar[tuple[str, ...]] = ("dynamic", "kinematic")
    """Values of ``EnvConfig.dynamics`` with which the task can be simulated."""
    moves_fingers: ClassVar[bool] = False
    """Whether it needs a robot whose fingers move."""
    knowledge_info: ClassVar[str] = "facet"
    """Info that names the row of the knowledge table for an episode."""
    training: ClassVar[Mapping[str, Mapping[str, Any]]] = {}
    """Fields of the task's experiments that differ from an algorithm's defaults, by algorithm."""
    column_meanings: ClassVar[dict[str, str]] = {}
    """What each of the ``columns`` holds."""
    measures: ClassVar[tuple[Measure, ...]] = ()
    """Further numbers of an evaluation, computed from ``columns`` and those of every evaluation."""
    kind: str = ""
    """Tag of the task in JSON, a literal of each task."""

    @classmethod
    def kind_of(cls) -> str:
        """Return the tag of the task in JSON and in the names of experiments.

        Raises:
            UserError: the class declares no field ``kind`` with one literal.
        """
        tags = get_args(get_type_hints(cls).get("kind"))
        if len(tags) != 1:
            raise UserError(
                f"The task {cls.__qualname__} needs a field that names it: kind: "
                f"Literal['{cls.__name__.lower()}'] = '{cls.__name__.lower()}'."
            )
        return str(tags[0])

    @property
    def title(self) -> str:
        """Words for the task in the titles of a report; none for the paper's."""
        return self.kind_of()

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
        """Whether the image shows the object to reach in magenta and the others in grey."""
        return False

    def area_of(self, robot: Robot) -> str:
        """Return the name of the robot's area in which episodes take place.

        Raises:
            UserError: the robot has none, and the task does not fit its standard rectangle.
        """
        return self.area

    @staticmethod
    def build_scene(robot: Robot, targets: Sequence[Target], distractors: int) -> Scene:
        """Build the scene of the task; by default objects have no physics."""
        return build_scene(robot, targets, distractors)

    def simulator(
        self, scene: Scene, num_envs: int, num_threads: int, dynamics: Dynamics
    ) -> MujocoSimulator:
        """Make the physics of n environments with a scene of `build_scene`; 0 threads: all cores.

        Methods of the task find it in ``EpisodeState.simulator``, where its class is that of
        ``EpisodeState[ItsSimulator]``.
        """
        return MujocoSimulator(scene, num_envs, num_threads, dynamics)

    def joint_names(self, robot: Robot) -> tuple[str, ...]:
        """Name the joints of the actions of a robot, those of the scene."""
        return robot.joints

    def teacher(self, state: EpisodeState) -> Teacher:
        """Make what knows the actions that solve running episodes, for imitation."""
        return Teacher(state)

    def guide(self, state: EpisodeState, seed: int, straight: bool) -> Guide:
        """Make what guides scripted agents to the solution of running episodes.

        Args:
            state: the episodes.
            seed: of the solver of the inverse kinematics.
            straight: whether the way ends straight along the approach direction.
        """
        return (StraightApproach if straight else ShortestWay)(state, seed)

    def sampler(self, setting: Setting) -> ObjectSampler:
        """Return what draws the objects of episodes, uniform by default (paper, table 1).

        Raises:
            UserError: the setting does not fit the task.
        """
        return OneObject(setting)

    def questions(self, facets: tuple[ObjectColour, ...]) -> QuestionTable | None:
        """Return the questions of the task; None if episodes have none."""
        return None

    def knowledge_rows(self, facets: tuple[ObjectColour, ...]) -> list[str]:
        """Name the rows of the knowledge table that ``knowledge_info`` refers to."""
        return ["/".join(facet) for facet in facets]

    def asking(self, **fields: Any) -> "Task":
        """Return the task with other questions of a graph, by fields of ``GraphQueries``.

        Raises:
            UserError: no graph answers questions of the task.
        """
        name, value = next(iter(fields.items()))
        raise UserError(
            f"The task {self.kind_of()!r} has no queries that a graph could answer, got {name}="
            f"{value!r}. Take a run of a task with such queries, or leave {name} out."
        )

    def edited_graph(self, facets: tuple[ObjectColour, ...]) -> "KnowledgeGraph | None":
        """Return the graph that answers instead of ``graph``, of split S5; else None."""
        return None

    def memory(self, num_envs: int) -> dict[str, NDArray[Any]]:
        """Return the arrays (n, ...) that the task remembers between steps, as an episode starts.

        They are stored and restored with the environment, and read from ``EpisodeState.memory``.
        """
        return {}

    def remember(self, state: EpisodeState) -> Mapping[str, NDArray[Any]]:
        """Return the arrays of ``memory`` after a step, new, with its distance and angle known."""
        return {}

    def goal(
        self, scene: Scene, objects: Integers, position: Floats, matrix: Floats
    ) -> tuple[Floats, Floats]:
        """Return the frame that the gripper has to reach in k episodes.

        Args:
            scene: robot and objects.
            objects: index of each episode's first object, (k,).
            position: its grasp point, world, (k, 3) [m].
            matrix: rotation from its grasp frame to world, row-major, (k, 9).
        """
        return position, matrix

    def success(self, state: EpisodeState) -> Mask:
        """Return which episodes are solved, (n,) bool; a solved one ends."""
        return is_success(state.distance, state.angle, state.thresholds[0], state.thresholds[1])

    def failure(self, state: EpisodeState) -> Mask | None:
        """Return which episodes end without success before the time limit, (n,) bool, or None."""
        return None

    def reward(self, state: EpisodeState) -> Floats:
        """Compute the reward of a step, (n,); the paper's by default (table 1)."""
        return paper_reward(state.distance, state.angle, state.success)

    def infos(self, state: EpisodeState) -> dict[str, NDArray[Any]]:
        """Return the infos of the current state, (n, ...) each; ``is_success`` among them."""
        return {
            "distance": state.distance,
            "angle": state.angle,
            "target": state.target,
            "colour": state.colours[:, 0],
            "facet": state.facet_names[state.facet],
            "is_success": state.success,
        }

    def knowledge_input(self, state: EpisodeState) -> Integers:
        """Return the row of the knowledge table for each current episode, (n,) int64."""
        return state.facet

    def columns(
        self, setting: Setting, infos: Mapping[str, NDArray[Any]]
    ) -> dict[str, NDArray[Any]]:
        """Return further columns of an evaluation's ``episodes.parquet``, (N,) each.

        Args:
            setting: what the episodes were drawn from.
            infos: the infos at the end of N episodes.
        """
        return {}

    def instruct(self, state: EpisodeState, setting: Setting, env_id: int) -> str:
        """Return an episode's goal in words that a policy may know: without the answer to a query.

        Recorded datasets have it as their task.
        """
        return self.describe(state, setting, env_id)

    def describe(self, state: EpisodeState, setting: Setting, env_id: int) -> str:
        """Describe the goal of one episode, as "red mug"."""
        target = state.scene.targets[int(state.objects[env_id, 0])]
        return f"{[*target.colours][int(state.colours[env_id, 0])]} {target.name}"
