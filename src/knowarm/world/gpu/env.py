"""Actions go in; images, rewards and infos of many reaching tasks come out, all on one device."""

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
from knowarm.world.arguments import check_state, masked_ids, spread_seeds
from knowarm.world.config import EnvConfig
from knowarm.world.env import ACTION_LEVELS, list_facets
from knowarm.world.episodes import EpisodeSource
from knowarm.world.gpu.actions import check_actions
from knowarm.world.gpu.device import find_device
from knowarm.world.gpu.measure import measure
from knowarm.world.gpu.memory import check_memory, free_memory
from knowarm.world.gpu.running import RunningEpisodes
from knowarm.world.gpu.simulation import DeviceSimulation
from knowarm.world.render.renderer import make_torch_renderer
from knowarm.world.rewards import is_success, reward_terms
from knowarm.world.scene import Scene, load_scene


class DeviceReachVectorEnv(VectorEnv[Tensor, Tensor, Tensor]):
    """n environments as ``ReachVectorEnv``'s, whose arguments and results are tensors of a device.

    Seeded alike, it plays the same episodes. Environments that end begin anew in the same step.
    On a GPU ``step`` only launches kernels, on torch's current stream: it waits for nothing, and
    an environment that does not begin anew is computed all the same and left as it was.

    Observations are uint8 images (n, H, W, 3), new at every call. Infos are tensors (n,), named
    as ``ReachVectorEnv``'s; ``step`` always adds

    - "final_obs": (n, H, W, 3) uint8, the last image of each episode that was truncated. The
      others' are undefined, and the next step overwrites all of them.
    - "_final_obs": (n,) bool, where an episode was truncated.
    - "final_info": the infos before new episodes began, valid where an episode ended.
    - "_final_info": (n,) bool, where an episode ended.

    Args:
        config: the task.
        num_envs: n.
        device: "cuda", or "cpu" for checking.

    Attributes:
        facets: (target, colour) names, as ``ReachVectorEnv.facets``.

    Raises:
        UserError: the device or what it needs is missing, its memory is too small, or the config
            asks for OpenGL.
    """

    def __init__(self, config: EnvConfig, num_envs: int, device: str = "cuda") -> None:
        if num_envs < 1:
            raise UserError(f"num_envs must be at least 1, got {num_envs}.")
        self.config = config
        self.num_envs = num_envs
        self.metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}
        self.scene: Scene = load_scene(
            config.robot, tuple(config.targets), config.randomization.distractors
        )
        scene, n, joints = self.scene, num_envs, self.scene.num_joints
        EpisodeSource(scene, config)  # refuses what cannot be drawn
        self.device = find_device(device)
        if self.device.type == "cuda":
            check_memory(scene, config, n, free_memory(self.device))
        self.facets, first_facet = list_facets(scene, config)
        side = config.image_size
        self.single_observation_space = spaces.Box(0, 255, (side, side, 3), np.uint8)
        self.single_action_space = spaces.MultiDiscrete(np.full(joints, len(ACTION_LEVELS)))
        self.action_space = batch_space(self.single_action_space, n)

        self.renderer = make_torch_renderer(scene, config, self.device)
        self.simulation = DeviceSimulation(scene, n, self.device, config.dynamics)
        self.running = RunningEpisodes(scene, config, n, self.device)
        place = self._place
        self._first_facet = place(first_facet)
        self._increments = place((config.mpi_rad * np.array(ACTION_LEVELS)).astype(np.float32))
        self._home = place(scene.home)
        self._lower, self._upper = place(scene.joint_lower), place(scene.joint_upper)
        self._lower32, self._upper32 = self._lower.float(), self._upper.float()
        self._everywhere = torch.ones(n, dtype=torch.bool, device=self.device)
        self._steps = torch.zeros(n, dtype=torch.int64, device=self.device)
        self._joint_targets = torch.zeros((n, joints), dtype=torch.float32, device=self.device)
        self._final_images = torch.zeros((n, side, side, 3), dtype=torch.uint8, device=self.device)
        self._start(self._everywhere, self.running.start_next(self._everywhere))
        self._measure()

    @cached_property
    def observation_space(self) -> spaces.Box:  # type: ignore[override]
        """Space of the observations; made when asked for, as its bounds fill n images' memory."""
        space = batch_space(self.single_observation_space, self.num_envs)
        assert isinstance(space, spaces.Box)
        return space

    @property
    def episode_steps(self) -> int:
        """No environment is truncated twice within so many steps."""
        return self.config.max_episode_steps

    @property
    def facet_ids(self) -> Tensor:
        """Facet of the episode now running, (n,) int64."""
        return self._first_facet[self.running.target] + self.running.colour

    @property
    def joint_positions(self) -> Tensor:
        """Joint angles as they are now, (n, J) float32 [rad]."""
        return self.simulation.joint_positions

    @property
    def joint_targets(self) -> Tensor:
        """Where the servos are sent, (n, J) float32 [rad]; actions add to it."""
        return self._joint_targets

    def reset(
        self,
        *,
        seed: int | list[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Tensor, dict[str, Any]]:
        """Start a new episode in every environment, or in those of a mask.

        Args:
            seed: as ``ReachVectorEnv.reset``.
            options: "episodes", the ``Episodes`` of the host to play instead of drawn ones, one
                for each environment that is reset; "reset_mask", (n,) bool, the environments to
                reset, a tensor or an array.

        Raises:
            UserError: a seed, mask or list of episodes of another length.
        """
        options = options or {}
        mask = options.get("reset_mask")
        ids = masked_ids(mask.cpu() if isinstance(mask, Tensor) else mask, self.num_envs)
        seeds = spread_seeds(seed, self.num_envs)
        seeded = ids[seeds.given[ids]]
        if len(seeded):
            self.running.seed(seeded, seeds.values[seeded])
        given = np.zeros(self.num_envs, dtype=np.bool_)
        given[ids] = True
        chosen = self._place(given)
        episodes = options.get("episodes")
        if episodes is None:
            offsets = self.running.start_next(chosen)
        elif len(episodes) == len(ids):
            offsets = self.running.start_given(ids, chosen, episodes)
        else:
            raise UserError(
                f"options['episodes'] holds {len(episodes)} episodes for {len(ids)} environments "
                "that are reset; give one each."
            )
        self._start(chosen, offsets)
        self._measure()
        return self._draw(), self._infos(self._everywhere)

    def step(self, actions: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, dict[str, Any]]:
        """Play one step in every environment.

        Args:
            actions: (n, J) int64 in 0..6, on the device. On a GPU other numbers are not noticed,
                which would mean waiting for it, but moved to the nearest of these.

        Returns:
            observation (n, H, W, 3) uint8, reward (n,) float32, terminated (n,) bool, truncated
            (n,) bool, and infos.

        Raises:
            UserError: actions of another shape, dtype or device; on the CPU also outside 0..6.
        """
        check_actions(actions, self._joint_targets, len(ACTION_LEVELS))
        levels = actions.clamp(0, len(ACTION_LEVELS) - 1)
        targets = self._joint_targets + self._increments[levels]
        self._joint_targets = targets.clamp(self._lower32, self._upper32)
        self.simulation.step(self._joint_targets)
        self._steps = self._steps + 1
        self._measure()
        terms = reward_terms(self._distance, self._angle, self._success)
        reward = terms["success"] + terms["distance"] + terms["angle"]
        terminated = self._success
        truncated = (self._steps >= self.config.max_episode_steps) & ~terminated
        ended = terminated | truncated

        final = self._infos(ended)
        self._draw_into(self._final_images, wanted=truncated)
        self._start(ended, self.running.start_next(ended))
        self._measure()
        infos = self._infos(self._everywhere) | {
            "final_obs": self._final_images,
            "_final_obs": truncated,
            "final_info": final,
            "_final_info": ended,
        }
        return self._draw(), reward, terminated, truncated, infos

    def get_state(self) -> dict[str, NDArray[Any]]:
        """Copy everything that is needed to go on, on the CPU device to the byte, to the host."""
        return self.running.get_state() | {
            "steps": self._steps.cpu().numpy().copy(),
            "joint_targets": self._joint_targets.cpu().numpy().copy(),
            "simulation": self.simulation.get_state(),
        }

    def set_state(self, state: dict[str, NDArray[Any]]) -> None:
        """Go on from a state of ``get_state``, of an environment with the same config and n.

        Raises:
            UserError: the state is another kind of environment's.
        """
        check_state(self.get_state(), state)
        self.running.set_state(state)
        self._steps = self._place(np.array(state["steps"]))
        self._joint_targets = self._place(np.array(state["joint_targets"]))
        self._start(torch.zeros_like(self._everywhere), torch.zeros_like(self._joint_targets))
        self.simulation.set_state(state["simulation"], self._joint_targets)
        self._measure()

    def close_extras(self, **kwargs: Any) -> None:
        """Wait for the device and report what it had no room for."""
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)
        self.simulation.check_overflow()

    def _start(self, mask: Tensor, joint_offsets: Tensor) -> None:
        """Put environments of a mask (n,) at the start of episodes, (n, J) [rad] from home."""
        joints = (self._home + joint_offsets).clamp(self._lower, self._upper).float()
        self._joint_targets = torch.where(mask[:, None], joints, self._joint_targets)
        self._steps = self._steps * ~mask
        self.simulation.reset(
            mask,
            self._joint_targets,
            self.running.position,
            self.running.shown.distractor_position,
        )

    def _measure(self) -> None:
        """Measure distance [m], angle [deg] and success of every environment as it is now."""
        simulation, running, config = self.simulation, self.running, self.config
        self._distance, self._angle = measure(
            simulation.tcp_position,
            simulation.tcp_matrix,
            running.grasp_position,
            running.grasp_matrix,
            config.ignore_roll,
        )
        self._success = is_success(
            self._distance, self._angle, config.success_distance_m, config.success_angle_deg
        )

    def _draw(self) -> Tensor:
        """Draw every environment as it is now, into a new tensor."""
        out = torch.empty_like(self._final_images)
        self._draw_into(out)
        return out

    def _draw_into(self, out: Tensor, wanted: Tensor | None = None) -> None:
        self.renderer.draw(
            self.simulation.geom_position,
            self.simulation.geom_matrix,
            *self.running.shown[:3],
            out=out,
            wanted=wanted,
        )

    def _infos(self, mask: Tensor) -> dict[str, Tensor]:
        """Metrics of the state as it is now, each with a mask of where it means something."""
        infos = {
            "distance": self._distance,
            "angle": self._angle,
            "target": self.running.target,
            "colour": self.running.colour,
            "facet": self.facet_ids,
            "is_success": self._success,
        }
        return infos | {f"_{name}": mask for name in infos}

    def _place(self, array: NDArray[Any]) -> Tensor:
        return torch.as_tensor(array, device=self.device)
