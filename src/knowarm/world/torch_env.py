"""Torch vector environment of the reaching task: what learning sees, on the CPU or a GPU."""

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
from knowarm.world.arguments import check_action_range
from knowarm.world.arrays import Array
from knowarm.world.backends import Simulator, SimulatorName
from knowarm.world.backends.device import check_memory, choose_backend, free_memory
from knowarm.world.backends.mujoco import MujocoSimulator
from knowarm.world.backends.warp import WarpSimulator
from knowarm.world.config import EnvConfig
from knowarm.world.episodes import EpisodeSource
from knowarm.world.render.renderer import TorchRenderer, make_renderer
from knowarm.world.step_graph import CudaRecorder, StepGraph
from knowarm.world.tasks.privileged import privileged_columns, privileged_state
from knowarm.world.tasks.reach import ACTION_LEVELS, ReachTask
from knowarm.world.vector_env import describe, draw_images

FINAL = "final."
"""Prefix of the infos before the resets of a step."""


class TorchReachVectorEnv(VectorEnv[Tensor, Tensor, Tensor]):
    """n environments as in ``ReachVectorEnv``, whose arguments and results are torch tensors.

    With the same seed it plays the same episodes. Environments that end are reset in the same
    step. On a GPU ``step`` only launches kernels, on torch's current stream, and never waits for
    the device; therefore every environment is computed and a mask selects those that are reset.
    On the CPU tensors share the memory of NumPy arrays.

    Observations are uint8 images (n, H, W, 3), new at every call. Infos are tensors (n,), named
    as those of ``ReachVectorEnv``, which are not to be written into. ``step`` always adds

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
        device: "cpu", or "cuda" for the first visible GPU.
        simulator: "mujoco" (float64, CPU only), "warp" (float32, GPU or, for checking, CPU), or
            None for MuJoCo on the CPU and Warp on a GPU.
        num_threads: threads of physics and rendering with "mujoco"; 0 for one per core.
        record_steps: on a GPU, record the fourth step as CUDA graphs and replay them from then on;
            see ``StepGraph``.

    Attributes:
        device: where the tensors are.
        task: the state of the episodes.
        simulation: the physics.
        renderer: draws the observations.
        facets: as those of ``ReachVectorEnv``.
        queries: likewise.
        privileged_columns: names of the D columns of the privileged state, with their meaning in
            `knowarm.world.tasks.privileged.privileged_columns`.
        report_final_observations: whether these images are drawn; True until a trainer that does
            not look at them clears it.
        report_privileged_state: whether infos contain the privileged state before resets; False
            until a trainer that learns from it sets it.

    Raises:
        UserError: the device or a package is missing, the GPU's memory is too small, or Warp is
            combined with OpenGL.
    """

    def __init__(
        self,
        config: EnvConfig,
        num_envs: int,
        *,
        device: str = "cpu",
        simulator: SimulatorName | None = None,
        num_threads: int = 0,
        record_steps: bool = True,
    ) -> None:
        self.config = config
        self.scene = scene = describe(self, config, num_envs)
        self.metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}
        EpisodeSource(scene, config)  # raises its errors before anything is allocated
        self.device, backend = choose_backend(device, simulator)
        if self.device.type == "cuda":
            check_memory(scene, config, num_envs, free_memory(self.device))
        side = config.image_size
        self.renderer: Any  # Renderer or TorchRenderer
        self.simulation: Simulator
        self._on_host = backend == "mujoco"
        if self._on_host:
            self.renderer = make_renderer(scene, config, side, num_threads)
            self.simulation = MujocoSimulator(scene, num_envs, num_threads, config.dynamics)
        else:
            self.renderer = TorchRenderer(scene, config, self.device)
            self.simulation = WarpSimulator(scene, num_envs, self.device, config.dynamics)
        shape = (num_envs, side, side, 3)
        self._final_images = torch.zeros(shape, dtype=torch.uint8, device=self.device)
        self.task = ReachTask(scene, config, self.simulation)
        self.facets, self.queries = self.task.facets, self.task.queries
        self.privileged_columns = privileged_columns(scene.num_joints)
        self.report_final_observations = True
        self.report_privileged_state = False
        self._everywhere = torch.ones(num_envs, dtype=torch.bool, device=self.device)
        self._graph: StepGraph | None = None
        if self.device.type == "cuda" and record_steps:
            self._graph = StepGraph(self.task, self._play, CudaRecorder(self.device))

    @cached_property
    def observation_space(self) -> spaces.Box:  # type: ignore[override]
        """Space of the observations; created on first use, because its bounds take 2 n images."""
        space = batch_space(self.single_observation_space, self.num_envs)
        assert isinstance(space, spaces.Box)
        return space

    @property
    def max_episode_steps(self) -> int:
        """Number of steps within which no environment is truncated twice."""
        return self.config.max_episode_steps

    @property
    def facet_ids(self) -> Tensor:
        """Row of the knowledge table for each current episode, (n,) int64: facet, or query."""
        return _tensor(self.task.facet_ids)

    @property
    def joint_positions(self) -> Tensor:
        """Current joint angles, (n, J) [rad], in the simulator's precision."""
        return _tensor(self.simulation.joint_positions)

    @property
    def joint_targets(self) -> Tensor:
        """Joint angles that the servos track, (n, J) [rad]; actions add to them."""
        return _tensor(self.task.joint_targets)

    @property
    def privileged_state(self) -> Tensor:
        """What the simulator knows about each current episode, (n, D) float32."""
        return _tensor(privileged_state(self.task)).float()

    @property
    def threshold_factor(self) -> float:
        """Factor of the success thresholds, at least 1; can be set between steps."""
        return self.task.threshold_factor

    @threshold_factor.setter
    def threshold_factor(self, factor: float) -> None:
        self.task.threshold_factor = factor

    def reset(
        self,
        *,
        seed: int | list[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Tensor, dict[str, Any]]:
        """Start a new episode in every environment, or in those of a mask.

        Args:
            seed: as in ``ReachVectorEnv.reset``.
            options: "episodes", the ``Episodes`` (of NumPy arrays) to play instead of drawn ones,
                one for each environment that is reset; "reset_mask", (n,) bool, the environments
                to reset, a tensor or an array.

        Raises:
            UserError: a seed, mask or list of episodes of the wrong length.
        """
        options = dict(options or {})
        if isinstance(mask := options.get("reset_mask"), Tensor):
            options["reset_mask"] = mask.cpu().numpy()
        self.task.reset(seed, options)
        return self._draw(), self._infos(self._everywhere)

    def step(self, actions: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, dict[str, Any]]:
        """Play one step in every environment.

        Args:
            actions: (n, J) int64 in 0..6, on the device. On a GPU values outside are clipped,
                since detecting them would mean waiting for it.

        Returns:
            observation (n, H, W, 3) uint8, reward (n,) of the simulator's dtype, terminated (n,)
            bool, truncated (n,) bool, and infos.

        Raises:
            UserError: actions of the wrong shape, dtype or device; on the CPU also outside 0..6.
        """
        shape = (self.num_envs, self.scene.num_joints)
        check_actions(actions, shape, self.device, len(ACTION_LEVELS))
        if self._graph is None:
            outputs, images = self._play(actions.numpy() if self._on_host else actions)
        else:
            reports = self.report_final_observations, self.report_privileged_state
            outputs, images = self._graph(actions, reports)
            assert isinstance(self.simulation, WarpSimulator)
            self.simulation.check_overflow()
        outputs = {name: _tensor(values) for name, values in outputs.items()}
        ended, truncated = outputs.pop("ended"), outputs.pop("truncated")
        metrics = [name.removeprefix(FINAL) for name in outputs if name.startswith(FINAL)]
        final = {name: outputs.pop(FINAL + name) for name in metrics}
        extra = {
            "final_info": final | _masks(final, ended),
            "_final_info": ended,
        }
        if self.report_final_observations:
            extra |= {"final_obs": self._final_images, "_final_obs": truncated}
        if self.report_privileged_state:
            extra["final_privileged_state"] = outputs.pop("final_privileged_state")
        reward, terminated = outputs.pop("reward"), outputs.pop("terminated")
        infos = outputs | _masks(outputs, self._everywhere) | extra
        return images, reward, terminated, truncated, infos

    def _play(self, actions: Array) -> tuple[dict[str, Array], Tensor]:
        """Play one step.

        Returns:
            Reward, flags and infos of the step, (n,) each, those before resets with the prefix
            ``FINAL``; and the images.
        """
        task = self.task
        task.move(actions if self._on_host else actions.clamp(0, len(ACTION_LEVELS) - 1))
        outcome = task.outcome()
        outputs = outcome._asdict() | {"ended": outcome.ended}
        if self.report_final_observations:
            self._draw_final(outcome.truncated)
        final = infos = task.metrics()
        if self.report_privileged_state:
            outputs["final_privileged_state"] = self.privileged_state
        selection = task.select_where(outcome.ended)
        if not selection.is_empty:
            task.start_next(selection)
            infos = task.metrics()
        return outputs | {FINAL + name: final[name] for name in final} | infos, self._draw()

    def get_state(self) -> dict[str, NDArray[Any]]:
        """Copy all that determines the following steps to the host; on the CPU to the byte."""
        return self.task.get_state()

    def set_state(self, state: dict[str, NDArray[Any]]) -> None:
        """Restore a state of ``get_state``, of an environment with the same config and n.

        Raises:
            UserError: the state belongs to another kind of environment.
        """
        # Run format 1 also stored which environments had ended; here none has after a step.
        self.task.set_state({name: array for name, array in state.items() if name != "ended"})

    def close_extras(self, **kwargs: Any) -> None:
        """Wait for the device and report problems of the simulation."""
        self.simulation.close()

    def _infos(self, mask: Tensor) -> dict[str, Any]:
        """Return the metrics of the current state as tensors, each with a mask (n,)."""
        metrics = {name: _tensor(values) for name, values in self.task.metrics().items()}
        return metrics | _masks(metrics, mask)

    def _draw(self) -> Tensor:
        """Draw all environments, into a new tensor."""
        if self._on_host:
            return torch.from_numpy(draw_images(self.renderer, self.task))
        images = torch.empty_like(self._final_images)
        self._render(images)
        return images

    def _render(self, out: Tensor, wanted: Tensor | None = None) -> None:
        """Draw the environments of a mask (n,), or all, on the device."""
        simulation, shown = self.simulation, self.task.shown
        self.renderer.draw(
            simulation.geom_position, simulation.geom_matrix, *shown[:3], out=out, wanted=wanted
        )

    def _draw_final(self, truncated: Array) -> None:
        """Draw the environments of a mask (n,) into their rows of the final images.

        On the CPU only these are computed; on a GPU the host does not know which they are.
        """
        if not self._on_host:
            self._render(self._final_images, wanted=truncated)
        elif truncated.any():
            ids = np.flatnonzero(truncated)
            self._final_images.numpy()[ids] = draw_images(self.renderer, self.task, ids)


def check_actions(actions: Any, shape: tuple[int, int], device: torch.device, levels: int) -> None:
    """Check actions as far as that is possible without waiting for a GPU.

    Raises:
        UserError: no int64 tensor of this shape (n, J) on the device; on the CPU also a value
            outside 0 to levels - 1.
    """
    fits = isinstance(actions, Tensor) and (
        (tuple(actions.shape), actions.dtype, actions.device) == (shape, torch.int64, device)
    )
    if not fits:
        given = type(actions).__name__
        if isinstance(actions, Tensor):
            given = f"{actions.dtype} of shape {tuple(actions.shape)} on {actions.device}"
        raise UserError(
            f"actions must be an int64 tensor of shape {shape} (environments, joints) on {device}, "
            f"got {given}."
        )
    if device.type == "cpu":
        check_action_range(actions.numpy(), levels)


def _masks(infos: dict[str, Tensor], mask: Tensor) -> dict[str, Tensor]:
    """Return Gymnasium's mask of each info."""
    return {f"_{name}": mask for name in infos}


def _tensor(array: Array) -> Tensor:
    """Return an array as a tensor of the same memory, and a tensor as it is."""
    return array if isinstance(array, Tensor) else torch.from_numpy(array)
