"""MuJoCo Warp backend: physics as torch tensors in float32, on a GPU or on the CPU."""

import copy
import importlib
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from knowarm.world.arrays import MaskSelection, NumpyArrays
from knowarm.world.backends import Dynamics
from knowarm.world.compose import SUBSTEPS
from knowarm.world.scene import Scene, target_places

CONTACTS_PER_WORLD = 32
"""Contacts allocated per world and shared by all worlds. Arms pressed into the floor with full
force had 12 per world on average; in random play one world in ten has one."""

ROWS_PER_WORLD = 256
"""Largest number of constraint rows of a world; such arms had up to 176."""

CONVEX_PER_WORLD = 4
"""Contacts found iteratively (cylinder on box, meshes) per world, shared likewise."""

_MAX_CONTACTS_PER_PAIR = 8


def import_warp() -> tuple[Any, Any]:
    """Import Warp and MuJoCo Warp without their messages on the terminal."""
    warp = importlib.import_module("warp")
    warp.config.log_level = warp.LOG_WARNING
    # Machine code: a driver need not be as new as Warp's compiler, and modules that were compiled
    # ahead of time are found.
    warp.config.cuda_output = "cubin"
    warp.init()
    return warp, importlib.import_module("mujoco_warp")


class TorchArrays(NumpyArrays):
    """Arrays of torch: float32, selections by mask; see ``NumpyArrays``.

    Args:
        device: where tensors are kept.
    """

    float_dtype = np.float32

    def __init__(self, device: torch.device) -> None:
        self.device = device

    def place(self, array: NDArray[Any]) -> Tensor:
        """Move an array to the device; uint64 becomes int64 with the same bits."""
        if array.dtype == np.uint64:
            array = array.view(np.int64)
        return torch.as_tensor(array, device=self.device)

    def to_host(self, array: Tensor) -> NDArray[Any]:
        """Copy a tensor to the host."""
        return array.cpu().numpy().copy()

    def select(self, env_ids: NDArray[np.intp], num_envs: int) -> MaskSelection:
        """Select environments by their indices, (k,)."""
        mask = np.zeros(num_envs, dtype=np.bool_)
        mask[env_ids] = True
        return MaskSelection(self.place(mask))

    def select_where(self, mask: Tensor) -> MaskSelection:
        """Select environments by a mask, (n,) bool."""
        return MaskSelection(mask)

    def spread(self, values: NDArray[Any], env_ids: NDArray[np.intp], num_envs: int) -> Tensor:
        """Write rows (k, ...) into rows ``env_ids`` of zeros (n, ...) on the device."""
        rows = np.zeros((num_envs, *values.shape[1:]), dtype=values.dtype)
        rows[env_ids] = values
        return self.place(rows)


class WarpSimulator:
    """``Simulator`` on MuJoCo Warp: the physics of ``MujocoSimulator`` in float32.

    The substeps of an action are one graph of Warp's, launched on torch's current stream, and no
    method but ``get_state`` and ``close`` waits for a GPU. Array attributes are live views of
    Warp's arrays.

    Args:
        scene: the scene to simulate.
        num_envs: n.
        device: a GPU, or the CPU.
        dynamics: how joints follow their targets.

    Attributes:
        launch: called with each launch of a graph; replaced while a step is recorded.
    """

    def __init__(
        self, scene: Scene, num_envs: int, device: torch.device, dynamics: Dynamics = "dynamic"
    ) -> None:
        self.scene = scene
        self.num_envs = num_envs
        self.dynamics = dynamics
        self.device = device
        self.arrays: NumpyArrays = TorchArrays(device)
        self._warp, self._mjw = import_warp()
        self._warp_device = self._warp.device_from_torch(device)
        with self._warp.ScopedDevice(self._warp_device):
            model = _for_warp(scene.model)
            self._model = self._mjw.put_model(model)
            # Overflows are reported once by check_overflow, not printed by every world.
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
        self.tcp_matrix: Tensor = view(data.site_xmat)[:, scene.tcp_site].view(num_envs, 9)
        self.geom_position: Tensor = view(data.geom_xpos)
        self.geom_matrix: Tensor = view(data.geom_xmat).view(num_envs, -1, 9)
        self._joints = torch.as_tensor(scene.qpos_index, device=device)
        self._targets = torch.as_tensor(scene.target_mocap, device=device)
        self._distractors = torch.as_tensor(scene.distractor_mocap, device=device)
        # Written by every step and read by a later one, when the copy has finished: no waiting.
        self._overflowed = torch.zeros((), dtype=torch.int32, pin_memory=device.type == "cuda")
        self._warned = False
        self._pose = self._prepared(self._run_pose)
        dynamic = dynamics == "dynamic"
        self._advance = self._prepared(self._run_substeps) if dynamic else self._pose
        self._overflow.zero_()
        self.launch: Callable[[Callable[[], None]], None] = lambda graph: graph()

    @property
    def joint_positions(self) -> Tensor:
        """Current joint angles, a copy, (n, J) [rad]."""
        return self._qpos[:, self._joints]

    def reset(
        self,
        selection: MaskSelection,
        joint_targets: Tensor,
        target_position: Tensor,
        distractor_position: Tensor | None = None,
    ) -> None:
        """Put selected environments at rest at joint angles; see ``Simulator.reset``."""
        rows = selection.mask[:, None]
        joints = torch.where(rows, joint_targets, self._qpos[:, self._joints])
        self._qpos.index_copy_(1, self._joints, joints)
        self._qvel.masked_fill_(rows, 0.0)
        self._warmstart.masked_fill_(rows, 0.0)
        self._place(joint_targets, target_position, distractor_position)
        self.launch(self._pose)

    def step(self, joint_targets: Tensor) -> None:
        """Advance every environment by one control period towards joint targets (n, J) [rad]."""
        if self.dynamics == "kinematic":
            self._qpos.index_copy_(1, self._joints, joint_targets)
        else:
            self._ctrl.copy_(joint_targets)
        self.launch(self._advance)
        self._overflowed.copy_(self._overflow.amax(), non_blocking=True)
        self.check_overflow()

    def check_overflow(self) -> None:
        """Warn once if a world had more contacts or constraints than were allocated.

        On a GPU the information is up to a few steps old.
        """
        if not self._warned and int(self._overflowed):
            self._warned = True
            kinds = self._mjw.OverflowType(int(self._overflowed))
            warnings.warn(
                f"MuJoCo Warp dropped contacts: {kinds.name} overflowed in at least one world "
                f"({self._data.njmax} rows per world, {self._data.naconmax} contacts in all). "
                "Poses of worlds in heavy contact are wrong; increase the constants in "
                "world/backends/warp.py.",
                RuntimeWarning,
                stacklevel=3,
            )

    def get_state(self) -> NDArray[np.float32]:
        """Copy joint positions, velocities and the solver's warm start to the host, (n, S)."""
        state = torch.cat([self._qpos, self._qvel, self._warmstart], dim=1)
        return state.cpu().numpy()

    def set_state(
        self,
        state: NDArray[np.float32],
        joint_targets: Tensor,
        target_position: Tensor,
        distractor_position: Tensor | None,
    ) -> None:
        """Restore a state of ``get_state``, (n, S); see ``Simulator.set_state``."""
        parts = torch.as_tensor(state, device=self.device).split(
            [self._qpos.shape[1], self._qvel.shape[1], self._warmstart.shape[1]], dim=1
        )
        for to, of in zip((self._qpos, self._qvel, self._warmstart), parts, strict=True):
            to.copy_(of)
        self._place(joint_targets, target_position, distractor_position)
        self.launch(self._pose)

    def close(self) -> None:
        """Wait for the device and report overflows of the last steps."""
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)
        self.check_overflow()

    def _place(
        self, joint_targets: Tensor, target_position: Tensor, distractor_position: Tensor | None
    ) -> None:
        """Set servo targets and object positions of all environments."""
        self._ctrl.copy_(joint_targets)
        places = target_places(self.scene, target_position).to(torch.float32)
        self._mocap[:, self._targets] = places
        if distractor_position is not None:
            self._mocap[:, self._distractors, :2] = distractor_position.to(torch.float32)

    def _run_pose(self) -> None:
        self._mjw.kinematics(self._model, self._data)

    def _run_substeps(self) -> None:
        # A step computes poses before it integrates, so the last substep's poses are still missing.
        for _ in range(SUBSTEPS):
            self._mjw.step(self._model, self._data)
        self._mjw.kinematics(self._model, self._data)

    def _prepared(self, run: Callable[[], None]) -> Callable[[], None]:
        """Return a function that repeats Warp's launches as one graph, on torch's stream."""
        warp, device = self._warp, self._warp_device
        with warp.ScopedDevice(device):
            run()  # compiles and loads kernels, which is not possible while capturing
            warp.synchronize_device(device)
            with warp.ScopedCapture(device) as capture:
                run()
            warp.synchronize_device(device)

        def launch() -> None:
            stream = warp.stream_from_torch(self.device) if device.is_cuda else None
            warp.capture_launch(capture.graph, stream=stream)

        return launch


class Capacity(NamedTuple):
    """Sizes of Warp's contact and constraint arrays."""

    contacts: int
    """Contacts of all worlds together."""

    convex: int
    """Those of them that are found iteratively."""

    rows: int
    """Constraint rows of one world."""


def capacity(model: mujoco.MjModel, num_envs: int) -> Capacity:
    """Choose array sizes for n worlds, at most what the model can fill.

    Args:
        model: the scene.
        num_envs: n.
    """
    pairs = int(np.triu(_may_touch(model), 1).sum())
    contacts = pairs * _MAX_CONTACTS_PER_PAIR
    # Pyramidal friction has two rows per direction; a joint's limits and friction one each.
    rows = contacts * max(1, 2 * (int(model.geom_condim.max()) - 1)) + 2 * model.njnt + model.nv
    shared = num_envs * min(contacts, CONTACTS_PER_WORLD) + contacts
    return Capacity(
        contacts=shared,
        convex=min(shared, num_envs * CONVEX_PER_WORLD + contacts),
        rows=min(rows, ROWS_PER_WORLD),
    )


def make_data(model: mujoco.MjModel, num_envs: int) -> Any:
    """Allocate Warp's arrays for n worlds of a model on Warp's current device."""
    _, mjw = import_warp()
    sizes = capacity(model, num_envs)
    return mjw.make_data(
        model,
        nworld=num_envs,
        naconmax=sizes.contacts,
        naccdmax=sizes.convex,
        njmax=sizes.rows,
    )


def _may_touch(model: mujoco.MjModel) -> np.ndarray:
    """Return whether two geoms of different bodies can be in contact, (G, G) bool."""
    kind, affinity = model.geom_contype[:, None], model.geom_conaffinity[None, :]
    meet = (kind & affinity) != 0
    body = model.body_weldid[model.geom_bodyid]
    return (meet | meet.T) & (body[:, None] != body[None, :])


def _for_warp(model: mujoco.MjModel) -> Any:
    """Copy the model with MuJoCo's own box-box collisions, those of ``mujoco.batch``.

    Warp's general routine finds a single contact where a finger's box lies on the table's, and
    arms then slide differently.
    """
    model = copy.copy(model)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_NATIVECCD)
    return model
