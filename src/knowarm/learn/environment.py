"""Vector environment of the learner: protocol, adapter for Gymnasium, threshold curriculum."""

from typing import Any, Protocol, cast

import numpy as np
import torch
from torch import Tensor

from knowarm.errors import UserError
from knowarm.learn.algorithms import ThresholdConfig
from knowarm.learn.checkpoint import Arrays

MIN_SUCCESS = 0.5
"""Success of an update's episodes above which success thresholds shrink."""
LATEST = (0.5, 0.75)
"""Fractions of a training between which success thresholds shrink to the task's, in any case."""

Infos = dict[str, Any]
StepResult = tuple[Tensor, Tensor, Tensor, Tensor, Infos]


class TorchVectorEnv(Protocol):
    """A vector environment of images with tensors of one device, and SAME_STEP autoreset.

    Where an episode ends, ``step`` returns the first image of the next one, and the infos hold

    - ``infos["final_obs"]``: (n, H, W, 3) uint8, the last image of each episode that was
      truncated, undefined elsewhere; present whenever an episode was truncated.
    - ``infos["final_info"]["is_success"]``: (n,) bool, defined where an episode ended; optional,
      terminated episodes count as successes without it.
    """

    num_envs: int
    """n."""

    @property
    def device(self) -> torch.device:
        """Device of all tensors."""

    @property
    def knowledge(self) -> Tensor:
        """What the policy knows in each running episode, (n, K) float32; K may be 0."""

    def reset(
        self,
        *,
        seed: int | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Tensor, Infos]:
        """Start new episodes; return images (n, H, W, 3) uint8 and infos."""

    def step(self, actions: Tensor) -> StepResult:
        """Advance every environment by one step.

        Args:
            actions: (n, J) int64.

        Returns:
            Images (n, H, W, 3) uint8, rewards (n,) float32 or float64, terminated (n,) bool,
            truncated (n,) bool, infos.
        """

    def get_state(self) -> Arrays:
        """Return all that `set_state` needs to continue identically."""

    def set_state(self, state: Arrays) -> None:
        """Continue from the result of `get_state`."""


class PrivilegedVectorEnv(TorchVectorEnv, Protocol):
    """A vector environment whose simulator's state can be used in training.

    With ``report_privileged_state``, infos contain ``final_privileged_state``, (n, D) float32: the
    state of every environment before the resets of the step.
    """

    privileged_columns: tuple[str, ...]
    """Names of the D columns; see `knowarm.world.envs.privileged.privileged_columns`."""
    report_privileged_state: bool
    """Set by the trainer."""

    @property
    def privileged_state(self) -> Tensor:
        """State of each running episode, (n, D) float32."""


class TeachingVectorEnv(PrivilegedVectorEnv, Protocol):
    """A vector environment with a teacher that solves the running episodes, for training.

    ``reset()`` without a seed starts the next episode in every environment.
    """

    practice_share: float
    """Share of the next episodes that start on the path to the goal, 0 to 1; set by the trainer."""

    def teach(self) -> tuple[Tensor, Tensor]:
        """Return the teacher's actions (n, J) int64, and the way to its solution (n, J) float32.

        The way is in units of the largest joint step.
        """


class NumpyToTorch:
    """Adapter that gives a NumPy vector environment the interface `TorchVectorEnv` on the CPU.

    Tensors share the memory of the environment's arrays where possible.

    Args:
        env: a Gymnasium vector environment with images (n, H, W, 3) uint8 as observations,
            MultiDiscrete actions and autoreset mode SAME_STEP. Optional members:
            ``knowledge_input`` (n,), rows of the table, 0 for every episode without it;
            ``get_state`` and ``set_state``, without which training cannot write checkpoints.
        table: (rows, K) float32, what the policy knows in the episodes of each row; None without
            knowledge.

    Raises:
        UserError: another autoreset mode.
    """

    device = torch.device("cpu")  #: Device of all tensors.

    def __init__(self, env: Any, table: np.ndarray | None = None) -> None:
        mode = (getattr(env, "metadata", None) or {}).get("autoreset_mode")
        mode = getattr(mode, "value", mode)
        if mode not in (None, "SameStep"):
            raise UserError(
                f"The environment's autoreset mode is {mode!r}; training needs SAME_STEP: create "
                "it with autoreset_mode=gymnasium.vector.AutoresetMode.SAME_STEP."
            )
        self.env = env
        self.num_envs: int = env.num_envs
        if table is None:
            table = np.zeros((1, 0))
        self._table = torch.as_tensor(table, dtype=torch.float32)

    @property
    def knowledge(self) -> Tensor:
        """As `TorchVectorEnv.knowledge`."""
        if not hasattr(self.env, "knowledge_input") or not self._table.shape[1]:
            return self._table[0].expand(self.num_envs, -1)
        rows = torch.from_numpy(np.asarray(self.env.knowledge_input, np.int64))
        highest = int(rows.max())
        if highest >= len(self._table):
            raise UserError(
                f"The knowledge table has {len(self._table)} rows and the environment has episodes "
                f"of row {highest}; build the table from the facets of this environment."
            )
        return self._table[rows]

    def reset(
        self,
        *,
        seed: int | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Tensor, Infos]:
        """As `TorchVectorEnv.reset`."""
        images, infos = self.env.reset(seed=seed, options=options)
        return torch.from_numpy(images), infos

    def step(self, actions: Tensor) -> StepResult:
        """As `TorchVectorEnv.step`."""
        images, reward, terminated, truncated, infos = self.env.step(actions.numpy())
        result: Infos = {}
        success = infos.get("final_info", {}).get("is_success")
        if success is not None:
            success = torch.from_numpy(np.asarray(success, np.bool_))
            result["final_info"] = {"is_success": success}
        ids = np.flatnonzero(truncated)
        if len(ids):
            final = np.zeros_like(images)
            final[ids] = np.stack([infos["final_obs"][i] for i in ids])
            result["final_obs"] = torch.from_numpy(final)
        return (
            torch.from_numpy(images),
            torch.from_numpy(np.asarray(reward)),
            torch.from_numpy(terminated),
            torch.from_numpy(truncated),
            result,
        )

    def get_state(self) -> Arrays:
        """As `TorchVectorEnv.get_state`."""
        if not hasattr(self.env, "get_state"):
            raise UserError(
                f"{type(self.env).__name__} has no get_state and set_state, which checkpoints "
                "need; add them, or train without checkpoints."
            )
        return cast(Arrays, self.env.get_state())

    def set_state(self, state: Arrays) -> None:
        """As `TorchVectorEnv.set_state`."""
        self.env.set_state(state)


class ThresholdCurriculum:
    """Sets the factor of an environment's success thresholds, if the config's is above 1."""

    def __init__(self, config: ThresholdConfig, env: Any) -> None:
        if isinstance(env, NumpyToTorch):
            env = env.env
        self._config = config
        self._env = env
        self.is_used = config.threshold_factor > 1
        if not self.is_used:
            return
        if not hasattr(env, "threshold_factor"):
            raise UserError(
                f"{type(env).__name__} has no threshold_factor, and the config's is "
                f"{config.threshold_factor}: leave it at 1, or give the environment an "
                "attribute of this name that multiplies its success thresholds."
            )
        self.factor = config.threshold_factor

    @property
    def factor(self) -> float:
        """Factor of the thresholds of distance and angle."""
        if not self.is_used:
            return 1.0
        return cast(float, self._env.threshold_factor)

    @factor.setter
    def factor(self, factor: float) -> None:
        self._env.threshold_factor = factor

    def get_state(self) -> Arrays:
        """Return the factor, if the curriculum is used."""
        if not self.is_used:
            return {}
        return {"threshold_factor": np.array(self.factor)}

    def set_state(self, state: Arrays) -> None:
        """Continue from the result of `get_state`."""
        if self.is_used:
            self.factor = float(state["threshold_factor"])

    def update(self, success: float, progress: float) -> None:
        """Decrease the factor after an update.

        Args:
            success: share of the update's episodes that succeeded, 0..1; above `MIN_SUCCESS` the
                factor falls by ``threshold_decrease``.
            progress: fraction of the training that is done, 0..1. Between the two of `LATEST` the
                factor's upper bound falls to 1: agents that fail end at the task's thresholds too.
        """
        if not self.is_used:
            return
        config = self._config
        factor = self.factor
        if success > MIN_SUCCESS:
            factor -= config.threshold_decrease
        begin, end = LATEST
        remaining = min(max((end - progress) / (end - begin), 0.0), 1.0)
        largest = 1 + (config.threshold_factor - 1) * remaining
        self.factor = max(1.0, min(factor, largest))
