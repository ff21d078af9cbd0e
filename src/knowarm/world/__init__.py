"""World: robots, scenes, simulation, rendering, tasks and environments.

``scene`` composes a MuJoCo model of a robot and its objects; ``backend`` simulates it; ``tasks``
draw episodes and judge the result; ``render`` draws the images; ``envs`` holds the environments,
``agents`` what plays in them. Importing this package imports no simulator.
"""

import itertools
from typing import TYPE_CHECKING, Any, Literal, overload

import gymnasium
from gymnasium.envs.registration import EnvSpec

from knowarm.errors import UserError, unknown_name
from knowarm.world.robots import KNOWN_ARMS, ROBOTS
from knowarm.world.tasks import find_task, task_names

if TYPE_CHECKING:
    from knowarm.world.envs.single_env import ArmEnv
    from knowarm.world.envs.torch_env import TorchArmVectorEnv
    from knowarm.world.envs.vector_env import ArmVectorEnv
    from knowarm.world.tasks.asked.asked import Asking
    from knowarm.world.tasks.skills.skill import Skill
    from knowarm.world.tasks.task import Task

    TaskChoice = str | Task | Asking | Skill | None

NAMESPACE = "knowarm"
"""Namespace of the Gymnasium ids."""


def env_id(robot: str, task: str = "reach") -> str:
    """Return the Gymnasium id of a robot and task, as "knowarm/IRB120Reach-v0"."""
    return f"{NAMESPACE}/{ROBOTS[robot].gym_name}{task.title().replace('-', '')}-v0"


def register_environments() -> None:
    """Register an id per robot and task, for ``gymnasium.make`` and ``gymnasium.make_vec``."""
    for name, (robot, task) in _ids().items():
        if name not in gymnasium.registry:
            gymnasium.registry[name] = _IdSpec(
                name,
                entry_point="knowarm.world.envs.gymnasium_ids:IdEnv",
                vector_entry_point="knowarm.world.envs.gymnasium_ids:make_id_vector",
                kwargs={"robot": robot, "task": task, "id_task": task},
            )


class _IdSpec(EnvSpec):
    """Spec of an id, whose limit of steps is the task's unless another one is set.

    The task is imported when the limit is read, since it imports the simulator.
    """

    @property
    def max_episode_steps(self) -> int:
        """Steps after which Gymnasium truncates an episode."""
        _, task = _ids()[self.id]
        return self._steps or find_task(task).skill.max_steps

    @max_episode_steps.setter
    def max_episode_steps(self, steps: int | None) -> None:
        self._steps = steps


def _ids() -> dict[str, tuple[str, str]]:
    """Return robot and task by Gymnasium id."""
    pairs = itertools.product(ROBOTS, task_names())
    return {env_id(robot, task): (robot, task) for robot, task in pairs}


@overload
def make(
    robot: str,
    num_envs: None = None,
    device: None = None,
    task: "TaskChoice" = ...,
    **options: Any,
) -> "ArmEnv": ...


@overload
def make(
    robot: str,
    num_envs: int,
    device: None = None,
    task: "TaskChoice" = ...,
    **options: Any,
) -> "ArmVectorEnv": ...


@overload
def make(
    robot: str,
    num_envs: int,
    device: Literal["cpu", "cuda"],
    task: "TaskChoice" = ...,
    **options: Any,
) -> "TorchArmVectorEnv": ...


def make(
    robot: str,
    num_envs: int | None = None,
    device: str | None = None,
    task: "TaskChoice" = None,
    **options: Any,
) -> Any:
    """Create an environment.

    Args:
        robot: a name in ``ROBOTS`` or ``KNOWN_ARMS``, a Gymnasium id, or the TOML file of your own
            robot.
        num_envs: number of environments; None for a single, unbatched one.
        device: None for NumPy arrays; "cpu" or "cuda" for torch tensors (with ``num_envs``).
        task: a task, what is asked, or a skill; the name of a task, or ``package.module:Name`` of
            your own; None for that of a Gymnasium id, else "reach".
        options: fields of ``EnvConfig``, and arguments of the environment's constructor.

    Returns:
        ``ArmEnv``, ``ArmVectorEnv`` or ``TorchArmVectorEnv``.

    Raises:
        UserError: an unknown robot or task, a device without ``num_envs``, or a wrong option.
    """
    from knowarm.world.envs.single_env import ArmEnv, make_vector_env

    ids = _ids()
    robot = str(robot)
    gym_id = robot if "/" in robot else f"{NAMESPACE}/{robot}"
    name = robot
    if gym_id in ids:
        name, id_task = ids[gym_id]
        if task not in (None, id_task):
            raise UserError(
                f"The id {robot!r} names the task {id_task!r}, and task is {task!r}. Leave out "
                f"task, or give the robot's name, {name!r}."
            )
        task = id_task
    known = [*ROBOTS, *KNOWN_ARMS]
    if name not in known and not name.endswith(".toml"):
        raise unknown_name("robot or environment", robot, [*known, *ids])
    options = {"robot": name, "task": "reach" if task is None else task, **options}
    if num_envs is None:
        if device is not None:
            raise UserError(
                f"device {device!r} needs a vector environment; pass num_envs as well, or leave "
                "out device."
            )
        return ArmEnv(**options)
    return make_vector_env(num_envs, device=device, **options)
