"""Gymnasium wrappers that add the knowledge vector to the image: ``Dict(image, knowledge)``."""

from typing import Any, cast

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from knowarm.errors import UserError
from knowarm.questions import find_rows
from knowarm.world.config import EnvConfig, facets_of
from knowarm.world.envs.single_env import ArmEnv
from knowarm.world.envs.vector_env import ArmVectorEnv

Observation = dict[str, NDArray[Any]]


class KnowledgeObservation(gymnasium.Wrapper):
    """Adds the knowledge vector of the current episode to the image of a ``ArmEnv``.

    Args:
        env: an environment.
        table: (R, K) float32, one row per `Task.knowledge_rows`: facets, or queries.

    Raises:
        UserError: a table with the wrong number of rows.
    """

    def __init__(self, env: gymnasium.Env, table: ArrayLike) -> None:
        super().__init__(env)
        if not isinstance(env.unwrapped, ArmEnv):
            raise _wrong("KnowledgeObservation", "ArmEnv", env)
        self._knowledge = _NamedTable(table, env.unwrapped.config)
        self.observation_space = self._knowledge.beside(env.observation_space)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; see ``ArmEnv.reset``."""
        image, info = self.env.reset(seed=seed, options=options)
        return self._observe(image, info), info

    def step(self, action: Any) -> tuple[Observation, Any, bool, bool, dict[str, Any]]:
        """Play one step; see ``ArmEnv.step``."""
        image, reward, terminated, truncated, info = self.env.step(action)
        return self._observe(image, info), reward, terminated, truncated, info

    def _observe(self, image: NDArray[np.uint8], info: dict[str, Any]) -> Observation:
        return {"image": image, "knowledge": self._knowledge.rows(info)[0]}


class VectorKnowledgeObservation(VectorWrapper):
    """Same as ``KnowledgeObservation`` for a ``ArmVectorEnv``, ``final_obs`` included."""

    def __init__(self, env: VectorEnv, table: ArrayLike) -> None:
        if not isinstance(env, VectorEnv) or not isinstance(env.unwrapped, ArmVectorEnv):
            raise _wrong("VectorKnowledgeObservation", "ArmVectorEnv", env)
        super().__init__(env)
        self._knowledge = _NamedTable(table, env.unwrapped.config)
        self.single_observation_space = self._knowledge.beside(env.single_observation_space)
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)

    def reset(
        self,
        *,
        seed: int | list[int | None] | None = None,  # wider than Gymnasium's annotation
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Start episodes; see ``ArmVectorEnv.reset``."""
        images, infos = self.env.reset(seed=cast(int, seed), options=options)
        return self._observe(images, infos), infos

    def step(
        self, actions: Any
    ) -> tuple[Observation, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Play one step; see ``ArmVectorEnv.step``."""
        images, rewards, terminated, truncated, infos = self.env.step(actions)
        if self.env.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP and "final_obs" in infos:
            final = infos["final_obs"].copy()
            ids = np.flatnonzero(infos["_final_obs"])
            for i, row in zip(ids, self._knowledge.rows(infos["final_info"], ids), strict=True):
                final[i] = {"image": final[i], "knowledge": row}
            infos = infos | {"final_obs": final}
        return self._observe(images, infos), rewards, terminated, truncated, infos

    def _observe(self, images: NDArray[np.uint8], infos: dict[str, Any]) -> Observation:
        return {"image": images, "knowledge": self._knowledge.rows(infos)}


def _wrong(wrapper: str, needed: str, env: object) -> UserError:
    return UserError(
        f"{wrapper} wraps a {needed}, got a {type(env).__name__}. Torch environments need no "
        "wrapper: their policy holds the table."
    )


class _NamedTable:
    """A knowledge table, whose rows are found by the names that infos hold."""

    def __init__(self, table: ArrayLike, config: EnvConfig) -> None:
        self._table: NDArray[np.float32] = np.asarray(table, dtype=np.float32)
        self._info = config.task.knowledge_info
        names = config.task.knowledge_rows(facets_of(config))
        self._rows = {name: row for row, name in enumerate(names)}
        shape = self._table.shape
        if len(shape) != 2 or shape[0] != len(names) or shape[1] == 0:
            raise UserError(
                f"table must have one row for each of the {len(names)} values of the info "
                f"{self._info!r} ({', '.join(names)}), got shape {shape}."
            )

    def rows(
        self, infos: dict[str, Any], ids: NDArray[np.intp] | slice = slice(None)
    ) -> NDArray[np.float32]:
        """Return the knowledge vectors (k, K) of some environments, by their infos."""
        return self._table[find_rows(self._info, np.ravel(infos[self._info])[ids], self._rows)]

    def beside(self, image: spaces.Space) -> spaces.Dict:
        """Return the space of the image beside an unbounded vector of float32."""
        knowledge = spaces.Box(-np.inf, np.inf, self._table.shape[1:], np.float32)
        return spaces.Dict({"image": image, "knowledge": knowledge})
