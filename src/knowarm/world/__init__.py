"""World: robots, scenes, simulation, rendering and environments of reaching and choosing.

``scene`` composes a MuJoCo model of a robot and targets; ``backends`` simulate it; ``tasks``
draw episodes, move the arm and judge the result; ``render`` draws the images; ``vector_env``,
``torch_env`` and ``single_env`` are the environments. Importing this package imports no simulator.
"""

from typing import Any

import gymnasium

from knowarm.errors import UserError, unknown_name
from knowarm.world.config import CHOICE_DEFAULTS
from knowarm.world.menagerie import KNOWN_ARMS
from knowarm.world.robots import ROBOTS

NAMESPACE = "knowarm"
"""Namespace of the Gymnasium ids."""


def env_id(robot: str) -> str:
    """Return the Gymnasium id of a registered robot's task, as "knowarm/IRB120Reach-v0"."""
    return f"{NAMESPACE}/{ROBOTS[robot].env_id}"


def choice_env_id(robot: str) -> str | None:
    """Return the Gymnasium id of a robot's choice task, as "knowarm/IRB120Choose-v0", or None."""
    name = ROBOTS[robot].choice_env_id
    return None if name is None else f"{NAMESPACE}/{name}"


def register_environments() -> None:
    """Register an id per robot and task, for ``gymnasium.make`` and ``gymnasium.make_vec``."""
    for robot in ROBOTS:
        for name, options in ((env_id(robot), {}), (choice_env_id(robot), CHOICE_DEFAULTS)):
            if name is not None and name not in gymnasium.registry:
                gymnasium.register(
                    name,
                    entry_point="knowarm.world.single_env:ReachEnv",
                    vector_entry_point="knowarm.world.single_env:make_vector_env",
                    kwargs={"robot": robot, **options},
                )


def make(robot: str, num_envs: int | None = None, device: str | None = None, **options: Any) -> Any:
    """Create an environment of the reaching task, or of the choice task by its Gymnasium id.

    Args:
        robot: a name in ``ROBOTS`` or ``KNOWN_ARMS``, a Gymnasium id, or the TOML file of your own
            robot.
        num_envs: number of environments; None for a single, unbatched one.
        device: None for NumPy arrays; "cpu" or "cuda" for torch tensors (with ``num_envs``).
        options: fields of ``EnvConfig``, and arguments of the environment's constructor.

    Returns:
        ``ReachEnv``, ``ReachVectorEnv`` or ``TorchReachVectorEnv``.

    Raises:
        UserError: an unknown robot, a device without ``num_envs``, or a wrong option.
    """
    from knowarm.world.single_env import ReachEnv, make_vector_env

    ids = {env_id(name): name for name in ROBOTS}
    choices = {full: name for name in ROBOTS if (full := choice_env_id(name))}
    short = robot if "/" in robot else f"{NAMESPACE}/{robot}"
    name = ids.get(short, choices.get(short, robot))
    if name not in {**ROBOTS, **KNOWN_ARMS} and not name.endswith(".toml"):
        known = [*ROBOTS, *KNOWN_ARMS, *ids, *choices]
        raise unknown_name("robot or environment", robot, known)
    if short in choices:
        options = CHOICE_DEFAULTS | options
    if num_envs is None:
        if device is not None:
            raise UserError(
                f"device {device!r} needs a vector environment; pass num_envs as well, or leave "
                "out device."
            )
        return ReachEnv(robot=name, **options)
    return make_vector_env(num_envs, device=device, robot=name, **options)
