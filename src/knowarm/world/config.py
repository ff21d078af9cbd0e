"""Configuration of an environment: robot, task, objects, thresholds and image."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal

from knowarm.config import check_values
from knowarm.errors import Argument, UserError
from knowarm.knowledge import KnowledgeGraph
from knowarm.questions import QuestionTable
from knowarm.ranges import within
from knowarm.world.objects import find_targets
from knowarm.world.robots import DEFAULT_ROBOT, find_robot
from knowarm.world.robots.robot import Robot
from knowarm.world.scene.appearance import VisualRandomization
from knowarm.world.scene.scene import Scene, load_scene
from knowarm.world.tasks import DEFAULT_TASK, find_task
from knowarm.world.tasks.held_out import HeldOut
from knowarm.world.tasks.reward import SUCCESS_ANGLE_DEG
from knowarm.world.tasks.sampling import Colours, Setting
from knowarm.world.tasks.task import Task

MAX_IMAGE_SIZE = 4096
SUCCESS_DISTANCE_M = 0.05  # Of training, as in the paper


@dataclass(frozen=True, kw_only=True)
class EnvConfig:
    """Robot, task, objects, thresholds and image. Defaults are the paper's training settings."""

    robot: str = DEFAULT_ROBOT
    """A robot that `knowarm list` names, or the TOML file of your own robot."""
    task: Task = field(default_factory=partial(find_task, DEFAULT_TASK))
    """What is asked and what has to be done; in Python also by name, or only one of both, such as
    ``Lift()``."""
    targets: tuple[str, ...] = ()
    """Names of `knowarm list` or TOML files; objects are drawn from them. Empty: the task's."""
    colours: Colours = "fixed"
    """Always a target's first colour, or one of its colours drawn per episode. A task may fix
    it."""
    dynamics: Literal["dynamic", "kinematic"] = "dynamic"
    """Servos, inertia and contacts, or joint angles set exactly."""
    max_episode_steps: int = 0
    """Steps after which an episode is truncated. 0: the task's, 50 as in the paper or more."""
    success_distance_m: float = 0.0
    """Distance from gripper to grasp point below which a target counts as reached [m]. 0: the
    robot's, 5 cm as in the paper where its description states none."""
    success_angle_deg: float = 0.0
    """Angle between gripper and grasp frame below which a target counts as reached [deg]. 0: the
    robot's, 15 as in the paper where its description states none."""
    ignore_roll: bool = False
    """Ignore the rotation about the approach axis in the angle. Where a threshold is left out, a
    robot's description may say it too."""
    mpi_rad: float | None = None
    """Maximum position increment (MPI), the largest joint step of an action [rad] (slides: [m]);
    None takes the robot's own."""
    image_size: int = 64
    """Width and height of the image [px]."""
    renderer: Literal["raycast", "opengl"] = "raycast"
    """KnowArm's ray caster, or MuJoCo's OpenGL renderer as the (slow) reference."""
    antialiasing: bool = True
    """Average four rays per pixel (ray caster only)."""
    mesh_detail: Literal["pixels", "full"] = "pixels"
    """Meshes of a robot simplified to what the image's pixels can show, or with all their
    triangles as the (slow) reference (ray caster only)."""
    randomization: VisualRandomization = field(default_factory=VisualRandomization)
    """What varies in the image besides the paper's colours; all off by default."""
    held_out: HeldOut | None = None
    """Colours and places reserved for a test of generalization; None reserves none."""

    def __post_init__(self) -> None:
        task = find_task(self.task)
        targets: Any = self.targets
        if isinstance(targets, str):
            targets = (targets,)
        derived = {
            "task": task,
            "targets": tuple(targets) or task.targets,
            "max_episode_steps": self.max_episode_steps or task.skill.max_steps,
            "colours": task.asked.colours or self.colours,
        }
        if not (self.success_distance_m and self.success_angle_deg):
            derived |= _thresholds(self)
        for name, value in derived.items():
            object.__setattr__(self, name, value)
        check_values(self)
        within(self, 1, MAX_IMAGE_SIZE, "image_size", where="EnvConfig.")
        if len(set(self.targets)) != len(self.targets):
            raise UserError(
                f"EnvConfig.targets contains a name twice: {', '.join(self.targets)}; list each "
                "once."
            )
        self._check_task()

    def rederived(self, changed: Iterable[str]) -> list[str]:
        """Return which fields are derived again where others are changed: those of the robot."""
        if "robot" not in changed:
            return []
        blank = replace(self, **_BLANK)
        return [name for name in _BLANK if getattr(self, name) == getattr(blank, name)]

    def _check_task(self) -> None:
        task = self.task
        if len(self.targets) < task.asked.visible:
            raise UserError(
                f"The task {task.name!r} shows {task.asked.visible} objects, and EnvConfig.targets "
                f"names {len(self.targets)}; all objects of an episode are different. Name more "
                "targets or show fewer objects."
            )
        if self.dynamics not in task.skill.dynamics:
            raise UserError(
                f"The task {task.name!r} cannot be simulated with {self.dynamics} dynamics. Take ",
                Argument("env.dynamics", task.skill.dynamics[0]),
                ".",
            )
        if task.asked.holds_out:
            return
        used = {
            "held_out": self.held_out,
            "randomization.distractors": self.randomization.distractors,
        }
        for name, value in used.items():
            if value:
                raise UserError(
                    f"EnvConfig.{name} cannot be combined with the task {task.name!r}, whose "
                    "questions decide what stands in the rectangle. Leave one of them out."
                )


_BLANK: dict[str, Any] = {
    "success_distance_m": 0.0,
    "success_angle_deg": 0.0,
    "ignore_roll": False,
}
"""Fields that are the robot's where they are left out."""


def _thresholds(config: EnvConfig) -> dict[str, Any]:
    """Return the thresholds of success, the robot's where the config states none."""
    robot = find_robot(config.robot)
    distance_m = config.success_distance_m or robot.success_distance_m
    angle_deg = config.success_angle_deg or robot.success_angle_deg
    return {
        "success_distance_m": distance_m or SUCCESS_DISTANCE_M,
        "success_angle_deg": angle_deg or SUCCESS_ANGLE_DEG,
        "ignore_roll": config.ignore_roll or robot.ignore_roll,
    }


def robot_of(config: EnvConfig) -> Robot:
    """Return the robot of a config as it is in the area of the task."""
    robot = find_robot(config.robot)
    return robot.for_area(config.task.area_of(robot))


def scene_of(config: EnvConfig) -> Scene:
    """Load the scene of a config."""
    task = config.task
    area = task.area_of(find_robot(config.robot))
    distractors = config.randomization.distractors
    return load_scene(
        config.robot, config.targets, distractors, area, task.skill.build_scene
    )


def setting_of(config: EnvConfig) -> Setting:
    """Return what the task of a config draws episodes from."""
    return Setting(scene_of(config), config.colours, config.held_out, facets_of(config))


def facets_of(config: EnvConfig) -> tuple[tuple[str, str], ...]:
    """List the (object, colour) pairs that a config shows; objects in config order."""
    facets = []
    for target in find_targets(config.targets):
        colours = list(target.colours)
        if config.colours != "randomized":
            colours = colours[:1]
        facets += [(target.name, colour) for colour in colours]
    return tuple(facets)


def known_places(config: EnvConfig) -> KnowledgeGraph | None:
    """Return the graph that says where the objects of a task belong; None where nothing asks it."""
    task = config.task
    if not task.skill.tells_facts:
        return None
    return task.asked.answering_graph(facets_of(config))


def questions_of(config: EnvConfig) -> QuestionTable | None:
    """Return the questions of a config's task; None if its episodes have none."""
    return config.task.asked.questions(facets_of(config))


def row_names(config: EnvConfig) -> list[str]:
    """Name the rows of the knowledge table of a config's task."""
    return config.task.asked.knowledge_rows(facets_of(config))
