"""Entry points of the Gymnasium ids, whose limit of steps is Gymnasium's."""

from typing import Any

from gymnasium.vector import VectorEnv

from knowarm.arrays import Array
from knowarm.errors import UserError
from knowarm.world.config import EnvConfig
from knowarm.world.envs.single_env import ArmEnv, make_vector_env
from knowarm.world.envs.vector_env import Infos
from knowarm.world.tasks import find_task


class IdEnv(ArmEnv):
    """An environment of ``gymnasium.make``: its wrapper ``TimeLimit`` truncates the episodes.

    Args:
        id_task: name of the task of the id.
        options: see ``ArmEnv``.
    """

    def __init__(self, id_task: str, **options: Any) -> None:
        super().__init__(**options)
        _check_task(id_task, self.config)

    def step(self, action: Array) -> tuple[Any, float, bool, bool, Infos]:
        """Play one step; an episode goes on until it is solved or has failed."""
        observation, reward, terminated, truncated, infos = super().step(action)
        if truncated:
            self.vector.go_on()
        return observation, reward, terminated, False, infos


def make_id_vector(id_task: str, **options: Any) -> VectorEnv[Any, Any, Any]:
    """Create the environment of ``gymnasium.make_vec``; see `make_vector_env`."""
    options["max_episode_steps"] = options.get("max_episode_steps") or 0
    env: Any = make_vector_env(**options)
    _check_task(id_task, env.config)
    return env


def _check_task(name: str, config: EnvConfig) -> None:
    """Refuse a task with more or fewer steps than that of the id, which Gymnasium counts."""
    steps = find_task(name).skill.max_steps
    task = config.task
    if steps != task.skill.max_steps:
        raise UserError(
            f"The id names the task {name!r}, of {steps} steps, and the task {task.name!r} has "
            f"{task.skill.max_steps}. Take its id, or knowarm.make({config.robot!r}, task=...)."
        )
