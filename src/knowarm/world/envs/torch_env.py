"""Torch vector environment: what learning sees."""

from functools import cached_property
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray
from torch import Tensor

from knowarm.errors import UserError
from knowarm.world.config import EnvConfig
from knowarm.world.envs.arguments import check_action_range
from knowarm.world.envs.privileged import privileged_columns, privileged_state
from knowarm.world.envs.running import RunningEpisodes
from knowarm.world.envs.vector_env import describe, draw_images
from knowarm.world.render.renderer import Renderer, make_renderer
from knowarm.world.tasks.state import ACTION_LEVELS, nearest_levels
from knowarm.world.tasks.teacher import COARSE_LEVELS, Teacher


class TorchArmVectorEnv(VectorEnv[Tensor, Tensor, Tensor]):
    """n environments as in ``ArmVectorEnv``, whose arguments and results are torch tensors.

    With the same seed it plays the same episodes. Environments that end are reset in the same
    step. Simulation and images are computed on the CPU, and the results are moved to ``device``;
    on the CPU tensors share the memory of NumPy arrays.

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
            `knowarm.experiment.build.Parts.table`; None without knowledge.

    Attributes:
        device: where the tensors are.
        running: the state of the episodes.
        simulation: the physics.
        renderer: draws the observations.
        facets: as those of ``ArmVectorEnv``.
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
        table: NDArray[np.float32] | None = None,
    ) -> None:
        self.config = config
        self.device = torch_device(device)
        self.scene, _ = describe(self, config, num_envs)
        self.metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}
        side = config.image_size
        self.renderer: Renderer = make_renderer(self.scene, config, side, num_threads)
        self.simulation = config.task.simulator(self.scene, num_envs, num_threads, config.dynamics)
        shape = (num_envs, side, side, 3)
        self._final_images = np.zeros(shape, dtype=np.uint8)
        self._final_tensor = self._tensor(self._final_images)
        self.running = RunningEpisodes(config, self.simulation)
        self.facets = self.running.facets
        rows = len(config.task.knowledge_rows(self.facets))
        self._table = self._tensor(np.zeros((rows, 0), np.float32) if table is None else table)
        if len(self._table) != rows:
            raise UserError(
                f"The knowledge table has {len(self._table)} rows, and the episodes of this task "
                f"have {rows}; build the table from its configuration."
            )
        self.privileged_columns = privileged_columns(self.running)
        self.report_final_observations = True
        self.report_privileged_state = False
        self._teacher: Teacher | None = None
        self._everywhere = torch.ones(num_envs, dtype=torch.bool, device=self.device)

    @cached_property
    def observation_space(self) -> spaces.Box:  # type: ignore[override]
        """Space of the observations; created on first use, because its bounds take 2 n images."""
        space = batch_space(self.single_observation_space, self.num_envs)
        assert isinstance(space, spaces.Box)
        return space

    @property
    def knowledge_input(self) -> Tensor:
        """Row of the knowledge table for each current episode, (n,) int64: facet, or query."""
        return self._tensor(self.running.knowledge_input)

    @property
    def knowledge(self) -> Tensor:
        """What a policy knows in each current episode, (n, K) float32."""
        return self._table[self.knowledge_input]

    @property
    def joint_positions(self) -> Tensor:
        """Current joint angles, (n, J) float64 [rad]."""
        return self._tensor(self.simulation.joint_positions)

    @property
    def joint_targets(self) -> Tensor:
        """Joint angles that the servos track, (n, J) float64 [rad]; actions add to them."""
        return self._tensor(self.running.joint_targets)

    @property
    def privileged_state(self) -> Tensor:
        """What the simulator knows about each current episode, (n, D) float32."""
        return self._tensor(privileged_state(self.running)).float()

    @property
    def practice_share(self) -> float:
        """Share of the next episodes that start on the teacher's way, 0 to 1; it can be set."""
        return self.teacher.practice_share

    @practice_share.setter
    def practice_share(self, share: float) -> None:
        self.teacher.practice_share = share

    @property
    def has_teacher(self) -> bool:
        """Whether the teacher is in use."""
        return self._teacher is not None

    @property
    def teacher(self) -> Teacher:
        """Solves the episodes by inverse kinematics, for training only; made on first use."""
        if self._teacher is None:
            self._teacher = self.config.task.teacher(self.running)
            self.running.change_episodes = self._teacher.practice
        return self._teacher

    def teach(self) -> tuple[Tensor, Tensor]:
        """Return the teacher's actions (n, J) int64, and the way to its solution (n, J) float32.

        The way is in units of the largest joint step.
        """
        error = self.teacher.error()
        return self._tensor(nearest_levels(error, COARSE_LEVELS)), self._tensor(error).float()

    @property
    def threshold_factor(self) -> float:
        """Factor of the success thresholds, at least 1; can be set between steps."""
        return self.running.threshold_factor

    @threshold_factor.setter
    def threshold_factor(self, factor: float) -> None:
        self.running.threshold_factor = factor

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Tensor, dict[str, Any]]:
        """Start a new episode in every environment, or in those of a mask.

        Args:
            seed: as in ``ArmVectorEnv.reset``.
            options: "episodes", the ``Episodes`` (of NumPy arrays) to play instead of drawn ones,
                one for each environment that is reset; "reset_mask", (n,) bool, the environments
                to reset, a tensor or an array.

        Raises:
            UserError: a seed, mask or list of episodes of the wrong length.
        """
        options = dict(options or {})
        if isinstance(mask := options.get("reset_mask"), Tensor):
            options["reset_mask"] = mask.cpu().numpy()
        self.running.reset(seed, options)
        infos = self._metrics()
        return self._draw(), infos | _masks(infos, self._everywhere)

    def step(self, actions: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, dict[str, Any]]:
        """Play one step in every environment.

        Args:
            actions: (n, J) int64 in 0..6, on the device.

        Returns:
            observation (n, H, W, 3) uint8, reward (n,) float64, terminated (n,) bool, truncated
            (n,) bool, and infos.

        Raises:
            UserError: actions of the wrong shape, dtype or device, or outside 0..6.
        """
        running, tensor = self.running, self._tensor
        running.move(running.increments[self._checked(actions)])
        outcome = running.outcome()
        reward, terminated, truncated = map(tensor, outcome)
        extra: dict[str, Any] = {}
        if self.report_final_observations:
            self._draw_final(outcome.truncated)
            extra = {"final_obs": self._final_tensor, "_final_obs": truncated}
        if self.report_privileged_state:
            extra["final_privileged_state"] = self.privileged_state
        ended, mask = outcome.ended, tensor(outcome.ended)
        final = infos = self._metrics()
        extra |= {"final_info": final | _masks(final, mask), "_final_info": mask}
        if ended.any():
            running.start_next(np.flatnonzero(ended))
            infos = self._metrics()
        infos = infos | _masks(infos, self._everywhere) | extra
        return self._draw(), reward, terminated, truncated, infos

    def get_state(self) -> dict[str, NDArray[Any]]:
        """Copy all that determines the following steps, to the byte."""
        return self.running.get_state()

    def set_state(self, state: dict[str, NDArray[Any]]) -> None:
        """Restore a state of ``get_state``, of an environment with the same config and n.

        Raises:
            UserError: the state belongs to another kind of environment.
        """
        self.running.set_state(state)

    def _tensor(self, array: NDArray[Any]) -> Tensor:
        """Return an array as a tensor on the device; on the CPU of the same memory."""
        return torch.from_numpy(array).to(self.device)

    def _checked(self, actions: Tensor) -> NDArray[np.int64]:
        """Return actions as an array; raises the errors of ``step``."""
        shape = (self.num_envs, self.scene.num_joints)
        given = type(actions).__name__
        if isinstance(actions, Tensor):
            if (actions.shape, actions.dtype, actions.device) == (shape, torch.int64, self.device):
                array: NDArray[np.int64] = actions.cpu().numpy()
                check_action_range(array, len(ACTION_LEVELS))
                return array
            given = f"{actions.dtype} of shape {tuple(actions.shape)} on {actions.device}"
        raise UserError(
            f"actions must be an int64 tensor of shape {shape} (environments, joints) on "
            f"{self.device}, got {given}."
        )

    def _metrics(self) -> dict[str, Any]:
        """Return the infos of the current state without masks, (n, ...) each."""
        return {
            name: values if values.dtype.kind == "U" else self._tensor(values)
            for name, values in self.running.infos().items()
        }

    def _draw(self) -> Tensor:
        """Draw all environments, into a new tensor."""
        return self._tensor(draw_images(self.renderer, self.running))

    def _draw_final(self, truncated: NDArray[np.bool_]) -> None:
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


def _masks(infos: dict[str, Any], mask: Tensor) -> dict[str, Tensor]:
    """Return Gymnasium's mask of each info."""
    return {f"_{name}": mask for name in infos}
