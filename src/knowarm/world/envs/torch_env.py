"""Torch vector environment: what learning sees."""

from functools import cached_property
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from torch import Tensor

from knowarm.arrays import Array, Floats32, Integers, Mask
from knowarm.errors import UserError
from knowarm.world.config import EnvConfig, row_names
from knowarm.world.envs.privileged import privileged_columns, privileged_state
from knowarm.world.envs.vector_env import BaseVectorEnv, Infos, draw_images
from knowarm.world.tasks.skills.teacher import COARSE_LEVELS, Teacher
from knowarm.world.tasks.state import nearest_levels


class TorchArmVectorEnv(BaseVectorEnv[Tensor]):
    """n environments as in ``ArmVectorEnv``, whose arguments and results are torch tensors.

    With the same seed it plays the same episodes. Environments that end are reset in the same
    step. Simulation and images are computed on the CPU, and the results are moved to ``device``;
    on the CPU tensors share the memory of NumPy arrays. It has the attributes of ``ArmVectorEnv``.

    Observations are uint8 images (n, H, W, 3), new at every call. Infos are tensors (n,), or NumPy
    arrays of names such as "facet", named as those of ``ArmVectorEnv``; they are not to be
    written into. ``step`` always adds

    - "final_obs": (n, H, W, 3) uint8, the last image of each episode that was truncated. Other
      rows are undefined, and the next step overwrites the tensor.
    - "_final_obs": (n,) bool, where an episode was truncated. Both are left out without
      ``report_final_observations``.
    - "final_info": the infos before the reset, valid where an episode ended.
    - "_final_info": (n,) bool, where an episode ended.
    - "final_privileged_state": (n, D) float32, the privileged state before the reset, if
      ``report_privileged_state`` is set.

    Args:
        config: the task.
        num_envs: n.
        device: where the tensors are: "cpu", or "cuda" for the first visible GPU.
        num_threads: threads of physics and rendering; 0 for one per core.
        table: (rows, K) float32, what a policy knows in the episodes of each row, such as
            `knowarm.experiment.knows.Knowledge.table`; None without knowledge.

    Attributes:
        device: where the tensors are.
        privileged_columns: names of the D columns of the privileged state, with their meaning in
            `knowarm.world.envs.privileged.privileged_columns`.
        report_final_observations: whether these images are drawn; True until a trainer that does
            not look at them clears it.
        report_privileged_state: whether infos contain the privileged state before resets; False
            until a trainer that learns from it sets it.

    Raises:
        UserError: the device is unknown or missing.
    """

    def __init__(
        self,
        config: EnvConfig,
        num_envs: int,
        *,
        device: str = "cpu",
        num_threads: int = 0,
        table: Floats32 | None = None,
    ) -> None:
        self.device = torch_device(device)
        super().__init__(config, num_envs, num_threads)
        self.metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}
        side = config.image_size
        self._final_images = np.zeros((num_envs, side, side, 3), np.uint8)
        self._final_tensor = self._tensor(self._final_images)
        rows = len(row_names(config))
        if table is None:
            table = np.zeros((rows, 0), np.float32)
        self._table = self._tensor(table)
        if len(self._table) != rows:
            raise UserError(
                f"The knowledge table has {len(self._table)} rows, and the episodes of this task "
                f"have {rows}; build the table from its configuration."
            )
        self.privileged_columns = privileged_columns(self.running)
        self.report_final_observations = True
        self.report_privileged_state = False

    @cached_property
    def observation_space(self) -> spaces.Box:  # type: ignore[override]
        """Space of the observations; created on first use, because its bounds take 2 n images."""
        space = batch_space(self.single_observation_space, self.num_envs)
        assert isinstance(space, spaces.Box)
        return space

    @property
    def knowledge(self) -> Tensor:
        """What a policy knows in each current episode, (n, K) float32."""
        return self._table[self.knowledge_input]

    @property
    def privileged_state(self) -> Tensor:
        """What the simulator knows about each current episode, (n, D) float32."""
        return self._tensor(privileged_state(self.running)).float()

    @property
    def practice_share(self) -> float:
        """Share of the next episodes that start on the teacher's path, 0 to 1; it can be set."""
        return self.teacher.practice_share

    @practice_share.setter
    def practice_share(self, share: float) -> None:
        self.teacher.practice_share = share

    @property
    def has_teacher(self) -> bool:
        """Whether the teacher is in use."""
        return "teacher" in vars(self)

    @cached_property
    def teacher(self) -> Teacher:
        """Solves the episodes by inverse kinematics, for training only; made on first use."""
        teacher = self.config.task.skill.teacher(self.running)
        self.running.change_episodes = teacher.practice
        return teacher

    def teach(self) -> tuple[Tensor, Tensor]:
        """Return the teacher's actions (n, J) int64, and the way to its solution (n, J) float32.

        The way is in units of the largest joint step.
        """
        error = self.teacher.error()
        levels = nearest_levels(error, COARSE_LEVELS)
        return self._tensor(levels), self._tensor(error).float()

    @property
    def threshold_factor(self) -> float:
        """Factor of the success thresholds, at least 1; can be set between steps."""
        return self.running.threshold_factor

    @threshold_factor.setter
    def threshold_factor(self, factor: float) -> None:
        self.running.threshold_factor = factor

    def step(self, actions: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Infos]:
        """Play one step in every environment.

        Args:
            actions: (n, J) int64 in 0..6, on the device.

        Returns:
            observation (n, H, W, 3) uint8, reward (n,) float64, terminated (n,) bool, truncated
            (n,) bool, and infos.

        Raises:
            UserError: actions of the wrong shape, dtype or device, or outside 0..6.
        """
        self._move(self._checked(actions))
        outcome = self.running.outcome()
        reward, terminated, truncated = map(self._tensor, outcome)
        extra: Infos = {}
        if self.report_final_observations:
            self._draw_final(outcome.truncated)
            extra["final_obs"] = self._final_tensor
            extra["_final_obs"] = truncated
        if self.report_privileged_state:
            extra["final_privileged_state"] = self.privileged_state
        ended = outcome.ended
        extra["final_info"] = self._infos(ended)
        extra["_final_info"] = self._tensor(ended)
        if ended.any():
            self.running.start_next(np.flatnonzero(ended))
        return self._observe(), reward, terminated, truncated, self._infos() | extra

    def _tensor(self, array: Array) -> Tensor:
        """Return an array as a tensor on the device; on the CPU of the same memory."""
        return torch.from_numpy(array).to(self.device)

    def _out(self, array: Array) -> Any:
        if array.dtype.kind == "U":
            return array
        return self._tensor(array)

    def _observe(self) -> Tensor:
        return self._tensor(draw_images(self.renderer, self.running))

    def _checked(self, actions: Tensor) -> Integers:
        """Return actions as an array; refuse those of another shape, dtype or device."""
        shape = (self.num_envs, self.scene.num_joints)
        got = type(actions).__name__
        if isinstance(actions, Tensor):
            if (actions.shape, actions.dtype, actions.device) == (
                shape,
                torch.int64,
                self.device,
            ):
                return np.asarray(actions.cpu())
            got = f"{actions.dtype} of shape {tuple(actions.shape)} on {actions.device}"
        raise UserError(
            f"actions must be an int64 tensor of shape {shape} (environments, joints) on "
            f"{self.device}, got {got}."
        )

    def _draw_final(self, truncated: Mask) -> None:
        """Draw the environments of a mask (n,) into their rows of the final images."""
        if truncated.any():
            ids = np.flatnonzero(truncated)
            self._final_images[ids] = draw_images(self.renderer, self.running, ids)
            self._final_tensor = self._tensor(self._final_images)


def torch_device(name: str) -> torch.device:
    """Return the device of a name, after checking that this machine has it."""
    if name not in ("cpu", "cuda", "cuda:0"):
        raise UserError(
            f"device must be 'cuda' or 'cpu', got {name!r}. Select another GPU than the first "
            "with the environment variable CUDA_VISIBLE_DEVICES."
        )
    if name == "cpu":
        return torch.device("cpu")
    if torch.version.cuda is None:
        raise UserError(
            f"device 'cuda' needs a torch built with CUDA; torch {torch.__version__} is built "
            "without. Install one from https://pytorch.org/get-started, or use the CPU."
        )
    if not torch.cuda.is_available():
        raise UserError(
            f"device 'cuda': torch {torch.__version__} (CUDA {torch.version.cuda}) finds no GPU. "
            "`nvidia-smi` must list one, with a driver at least as new as that CUDA, and "
            "CUDA_VISIBLE_DEVICES must not hide it; or use the CPU."
        )
    return torch.device("cuda", 0)
