"""Joint targets go in; poses of joints, gripper and geoms come out, all tensors of one device."""

import copy
import warnings
from collections.abc import Callable
from typing import Any, Literal

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from knowarm.world.compose import SUBSTEPS
from knowarm.world.gpu.capacity import capacity
from knowarm.world.gpu.device import import_warp
from knowarm.world.scene import Scene, target_places


class DeviceSimulation:
    """n copies of a scene in MuJoCo Warp: the same physics as ``Simulation``, in float32.

    On a GPU the substeps of an action are one CUDA graph, launched on torch's current stream. No
    method waits for the GPU.

    Attributes (live views of Warp's arrays, float32, refreshed by ``reset`` and ``step``):
        tcp_position: (n, 3) [m], world. tcp_matrix: (n, 3, 3), rotation from gripper to world.
        geom_position: (n, G, 3) [m], world. geom_matrix: (n, G, 9), rotation from geom to world.

    Args:
        scene: what is simulated.
        num_envs: n.
        device: a GPU, or the CPU.
        dynamics: as ``Simulation``'s.
    """

    def __init__(
        self,
        scene: Scene,
        num_envs: int,
        device: torch.device,
        dynamics: Literal["dynamic", "kinematic"] = "dynamic",
    ) -> None:
        self.scene = scene
        self.dynamics = dynamics
        self.device = device
        self._warp, self._mjw = import_warp()
        self._warp_device = self._warp.device_from_torch(device)
        with self._warp.ScopedDevice(self._warp_device):
            model = _for_warp(scene.model)
            self._model = self._mjw.put_model(model)
            # Overflows are reported below, once, instead of printed by every world.
            self._model.opt.warn_overflow = 0
            if device.type == "cuda":
                # Lets the solver's loop end early inside a graph; needs a driver of CUDA 12.4.
                self._model.opt.graph_conditional = self._warp.is_conditional_graph_supported()
            self._data = make_data(model, num_envs)
        view, data = self._warp.to_torch, self._data
        self._qpos: Tensor = view(data.qpos)
        self._qvel: Tensor = view(data.qvel)
        self._ctrl: Tensor = view(data.ctrl)
        self._warmstart: Tensor = view(data.qacc_warmstart)
        self._mocap: Tensor = view(data.mocap_pos)
        self._overflow: Tensor = view(data.overflow)
        self.tcp_position: Tensor = view(data.site_xpos)[:, scene.tcp_site]
        self.tcp_matrix: Tensor = view(data.site_xmat)[:, scene.tcp_site]
        self.geom_position: Tensor = view(data.geom_xpos)
        self.geom_matrix: Tensor = view(data.geom_xmat).view(num_envs, -1, 9)
        self._joints = torch.as_tensor(scene.qpos_index, device=device)
        self._targets = torch.as_tensor(scene.target_mocap, device=device)
        self._distractors = torch.as_tensor(scene.distractor_mocap, device=device)
        # Copied to at every step and read later, when the copy has long been made: no waiting.
        self._overflowed = torch.zeros((), dtype=torch.int32, pin_memory=device.type == "cuda")
        self._warned = False
        self._pose = self._prepared(self._run_pose)
        dynamic = dynamics == "dynamic"
        self._advance = self._prepared(self._run_substeps) if dynamic else self._pose
        self._overflow.zero_()

    @property
    def joint_positions(self) -> Tensor:
        """Joint angles as they are now, a copy, (n, J) [rad]."""
        return self._qpos[:, self._joints]

    def reset(
        self,
        mask: Tensor,
        joint_positions: Tensor,
        target_position: Tensor,
        distractor_position: Tensor | None = None,
    ) -> None:
        """Put the environments of a mask to rest at joint angles.

        Args:
            mask: (n,) bool.
            joint_positions: where the joints begin, or elsewhere where their servos are sent,
                (n, J) float32 [rad].
            target_position: x and y of the targets of all environments [m], (n, 2).
            distractor_position: x and y of the distractors [m], (n, D, 2); None without any.
        """
        rows = mask[:, None]
        joints = torch.where(rows, joint_positions, self._qpos[:, self._joints])
        self._qpos.index_copy_(1, self._joints, joints)
        self._qvel.masked_fill_(rows, 0.0)
        self._warmstart.masked_fill_(rows, 0.0)
        self._ctrl.copy_(joint_positions)
        places = target_places(self.scene, target_position).to(torch.float32)
        self._mocap[:, self._targets] = places[:, None, :]
        if distractor_position is not None:
            self._mocap[:, self._distractors, :2] = distractor_position.to(torch.float32)
        self._pose()

    def step(self, joint_targets: Tensor) -> None:
        """Move every environment for one control period towards joint targets (n, J) [rad]."""
        if self.dynamics == "kinematic":
            self._qpos.index_copy_(1, self._joints, joint_targets)
        else:
            self._ctrl.copy_(joint_targets)
        self._advance()
        self._overflowed.copy_(self._overflow.amax(), non_blocking=True)
        self.check_overflow()

    def check_overflow(self) -> None:
        """Warn once if a world had more contacts or constraints than were set aside for it.

        On a GPU this sees what happened up to a few steps ago.
        """
        if not self._warned and int(self._overflowed):
            self._warned = True
            kinds = self._mjw.OverflowType(int(self._overflowed))
            warnings.warn(
                f"MuJoCo Warp left contacts out: {kinds.name} overflowed in at least one world "
                f"({self._data.njmax} rows a world, {self._data.naconmax} contacts in all). Poses "
                "of worlds in heavy contact are off; raise the numbers in world/gpu/capacity.py.",
                RuntimeWarning,
                stacklevel=3,
            )

    def get_state(self) -> NDArray[np.float32]:
        """Copy what the physics continues from besides targets' places, (n, S)."""
        state = torch.cat([self._qpos, self._qvel, self._warmstart], dim=1)
        return state.cpu().numpy()

    def set_state(self, state: NDArray[np.float32], joint_targets: Tensor) -> None:
        """Continue from a state of ``get_state``, (n, S), and joint targets (n, J) [rad]."""
        parts = torch.as_tensor(state, device=self.device).split(
            [self._qpos.shape[1], self._qvel.shape[1], self._warmstart.shape[1]], dim=1
        )
        for to, of in zip((self._qpos, self._qvel, self._warmstart), parts, strict=True):
            to.copy_(of)
        self._ctrl.copy_(joint_targets)
        self._pose()

    def _run_pose(self) -> None:
        self._mjw.kinematics(self._model, self._data)

    def _run_substeps(self) -> None:
        # A step computes poses before it moves, so those after the last substep come by themselves.
        for _ in range(SUBSTEPS):
            self._mjw.step(self._model, self._data)
        self._mjw.kinematics(self._model, self._data)

    def _prepared(self, run: Callable[[], None]) -> Callable[[], None]:
        """Turn Warp's launches into a function that repeats them: on a GPU a CUDA graph."""
        warp, device = self._warp, self._warp_device
        if not device.is_cuda:

            def call() -> None:
                with warp.ScopedDevice(device):
                    run()

            return call
        with warp.ScopedDevice(device):
            run()  # compiles and loads, which a capture cannot
            torch.cuda.synchronize()
            with warp.ScopedCapture(device) as capture:
                run()
            warp.synchronize_device(device)

        def launch() -> None:
            warp.capture_launch(capture.graph, stream=warp.stream_from_torch(self.device))

        return launch


def make_data(model: mujoco.MjModel, num_envs: int) -> Any:
    """Make Warp's arrays for n worlds of a model, on Warp's current device."""
    _, mjw = import_warp()
    sizes = capacity(model, num_envs)
    return mjw.make_data(
        model,
        nworld=num_envs,
        naconmax=sizes.contacts,
        naccdmax=sizes.convex,
        njmax=sizes.rows,
    )


def _for_warp(model: mujoco.MjModel) -> Any:
    """The model with the collisions of ``mujoco.batch``: box meets box by MuJoCo's own routine.

    Warp's general one finds a single contact where a finger's box lies on the table's, and arms
    then slide differently.
    """
    model = copy.copy(model)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_NATIVECCD)
    return model
