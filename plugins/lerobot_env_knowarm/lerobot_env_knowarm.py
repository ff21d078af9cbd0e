"""LeRobot environment plugin: the frozen episodes of KnowArm-Bench.

LeRobot imports every installed package named ``lerobot_env_*`` when it starts. The import registers
the environment type ``knowarm``: ``--env.type=knowarm --env.task=reach-v1/irb120-fixed``.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import repeat
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorEnv
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.utils.constants import ACTION, OBS_IMAGE, OBS_STATE
from numpy.typing import NDArray

from knowarm import UserError
from knowarm.benchmark.suites import Cell, find_cells, read_suite
from knowarm.world.config import scene_of
from knowarm.world.envs.running import joint_increments
from knowarm.world.envs.single_env import ArmEnv

Observation = dict[str, NDArray[Any]]


class BenchmarkEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """Plays the episodes of a cell: seed s starts episode s, no seed the next one.

    Args:
        suite: name of a suite.
        cell: name of one of its cells.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012 (Gymnasium's name)

    def __init__(self, suite: str, cell: str) -> None:
        frozen = read_suite(suite).cells[cell]
        config = frozen.env
        scene = scene_of(config)
        self._episodes = frozen.episodes
        self._arm = ArmEnv("rgb_array", observe=("image", "joints"), **vars(config))
        self.task = f"{suite}/{cell}"
        self.render_mode = "rgb_array"
        self._max_episode_steps = config.max_episode_steps
        self._increments = joint_increments(scene.robot, config)
        self._lower = scene.joint_lower
        self._upper = scene.joint_upper
        self._number = -1
        self.observation_space = spaces.Dict(_renamed(self._arm.observation_space))
        self.action_space = spaces.Box(
            self._lower.astype(np.float32), self._upper.astype(np.float32)
        )

    @property
    def task_description(self) -> str:
        """The query of the current episode, or its object where there is none, as "red mug"."""
        return self._arm.instruction

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start the episode of a seed, or the next one."""
        super().reset(seed=seed)
        number = self._number + 1
        if seed is not None:
            number = seed
        self._number = number % len(self._episodes)
        start = self._episodes[self._number : self._number + 1]
        observation, info = self._arm.reset(options={"episodes": start})
        return _renamed(observation), {"is_success": info["is_success"]}

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Move each joint by the increment that leads nearest to its target [rad].

        Raises:
            UserError: the action is not one finite number per joint.
        """
        wanted = np.asarray(action)
        shape = self.action_space.shape
        if wanted.shape != shape or not np.isfinite(wanted).all():
            raise UserError(
                f"An action must be finite numbers of shape {shape}, got "
                f"{wanted.ravel().tolist()} of shape {wanted.shape}."
            )
        targets = self._arm.joint_targets[:, None] + self._increments
        reached = targets.clip(self._lower[:, None], self._upper[:, None])
        levels = np.abs(reached - wanted[:, None]).argmin(1)
        observation, *outcome, info = self._arm.step(levels)
        return _renamed(observation), *outcome, {"is_success": info["is_success"]}

    def render(self) -> NDArray[np.uint8]:
        """Draw the policy's view, (480, 480, 3) uint8."""
        return self._arm.render()


def _renamed(parts: Mapping[str, Any]) -> dict[str, Any]:
    """Return image and joints under the names that LeRobot reads."""
    return {"pixels": parts["image"], "agent_pos": parts["joints"]}


@EnvConfig.register_subclass("knowarm")
@dataclass
class KnowArmEnv(EnvConfig):
    """Cells of a suite with the same joints, one LeRobot task each."""

    task: str | None = "reach-v1/irb120"
    """SUITE/CELL, or the beginning of the cell's name; SUITE may be the folder of your own."""
    fps: int = 10
    features_map: dict[str, str] = field(
        default_factory=lambda: {
            ACTION: ACTION,
            "agent_pos": OBS_STATE,
            "pixels": OBS_IMAGE,
        }
    )

    def __post_init__(self) -> None:
        suite, cells = find_cells(str(self.task))
        by_shape: dict[tuple[int, ...], list[str]] = {}
        for cell in cells:
            shape = cell.episodes.joint_offsets.shape[1:]
            by_shape.setdefault(shape, []).append(f"{suite.name}/{cell.name}")
        if len(by_shape) > 1:
            fitting = " or ".join(names[0] for names in by_shape.values())
            raise UserError(
                f"env.task {self.task!r} names cells of robots with different numbers of joints; "
                f"name one robot's, such as {fitting}."
            )
        size = cells[0].env.image_size
        self.features = {
            ACTION: PolicyFeature(type=FeatureType.ACTION, shape=shape),
            "agent_pos": PolicyFeature(type=FeatureType.STATE, shape=shape),
            "pixels": PolicyFeature(type=FeatureType.VISUAL, shape=(size, size, 3)),
        }

    def cells(self) -> list[Cell]:
        """Return the cells of ``task``.

        Raises:
            UserError: an unknown suite or cell.
        """
        return find_cells(str(self.task))[1]

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """No arguments: `create_envs` makes the environments."""
        return {}

    def create_envs(
        self, n_envs: int, use_async_envs: bool = False
    ) -> dict[str, dict[int, VectorEnv[Any, Any, Any]]]:
        """Make a vector environment per cell."""
        make: Any = SyncVectorEnv
        if use_async_envs and n_envs > 1:
            make = partial(AsyncVectorEnv, context="forkserver")
        suite = find_cells(str(self.task))[0].name
        envs = {}
        for number, cell in enumerate(self.cells()):
            makers = list(repeat(partial(BenchmarkEnv, suite, cell.name), n_envs))
            envs[number] = make(makers, autoreset_mode=AutoresetMode.SAME_STEP)
        return {suite: envs}
