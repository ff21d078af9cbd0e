"""Joint targets go in; poses of joints, gripper and geoms of every environment come out."""

import copy
from typing import Literal

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from knowarm.world.compose import SUBSTEPS
from knowarm.world.scene import Scene, target_places

_POSES = mujoco.mjtStage.mjSTAGE_POS.value


class Simulation:
    """n copies of a scene on MuJoCo's thread pool; results depend on neither n nor threads.

    "dynamic" moves the joints by position servos, ``SUBSTEPS`` physics steps an action;
    "kinematic" sets them exactly and computes poses only.

    Attributes (live views, all float64, refreshed by ``reset``, ``step`` and ``set_state``):
        joint_positions: (n, J) [rad], the joints the agent moves.
        tcp_position: (n, 3) [m], world. tcp_matrix: (n, 9), rotation from gripper to world.
        geom_position: (n, G, 3) [m], world. geom_matrix: (n, G, 9), rotation from geom to world.
    """

    def __init__(
        self,
        scene: Scene,
        num_envs: int,
        num_threads: int = 0,
        dynamics: Literal["dynamic", "kinematic"] = "dynamic",
    ) -> None:
        self.scene = scene
        self.dynamics = dynamics
        model = scene.model
        if dynamics == "kinematic":
            # Poses need no contacts and no constraints.
            model = copy.copy(model)
            model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
            model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        self.batch = Batch(model, num_envs, num_threads)
        self._qpos = self.batch.bind("qpos")
        self._qvel = self.batch.bind("qvel")
        self._ctrl = self.batch.bind("ctrl")
        self._warmstart = self.batch.bind("qacc_warmstart")
        self._mocap = self.batch.bind("mocap_pos")
        self._site_position = self.batch.bind("site_xpos")
        self._site_matrix = self.batch.bind("site_xmat")
        self.geom_position: NDArray[np.float64] = self.batch.bind("geom_xpos")
        self.geom_matrix: NDArray[np.float64] = self.batch.bind("geom_xmat")

    @property
    def joint_positions(self) -> NDArray[np.float64]:
        """Joint angles as they are now, a copy, (n, J) [rad]."""
        return self._qpos[:, self.scene.qpos_index]

    @property
    def tcp_position(self) -> NDArray[np.float64]:
        """Position of the gripper, (n, 3) [m], world."""
        return self._site_position[:, self.scene.tcp_site]

    @property
    def tcp_matrix(self) -> NDArray[np.float64]:
        """Rotation from gripper to world, (n, 9), row by row."""
        return self._site_matrix[:, self.scene.tcp_site]

    def reset(
        self,
        ids: NDArray[np.intp],
        joint_positions: NDArray[np.float64],
        target_position: NDArray[np.float64],
        distractor_position: NDArray[np.float64] | None = None,
    ) -> None:
        """Put environments to rest at joint angles, with the targets at a place.

        Args:
            ids: the environments, (k,).
            joint_positions: (k, J) [rad].
            target_position: x and y of the targets (one is visible) [m], (k, 2).
            distractor_position: x and y of the distractors [m], (k, D, 2); None without any.
        """
        self._qpos[ids[:, None], self.scene.qpos_index] = joint_positions
        self._qvel[ids] = 0.0
        self._warmstart[ids] = 0.0
        self._ctrl[ids] = joint_positions
        places = target_places(self.scene, target_position)
        self._mocap[ids[:, None], self.scene.target_mocap] = places[:, None, :]
        if distractor_position is not None:
            at = ids[:, None], self.scene.distractor_mocap
            self._mocap[(*at, slice(2))] = distractor_position
        self.batch.forward(ids=ids, stage=_POSES)

    def step(self, joint_targets: NDArray[np.float64]) -> None:
        """Move every environment for one control period towards joint targets (n, J) [rad]."""
        if self.dynamics == "kinematic":
            self.set_joints(joint_targets)
        else:
            self._ctrl[:] = joint_targets
            self.batch.step(nstep=SUBSTEPS, stage=_POSES)

    def set_joints(self, joint_positions: NDArray[np.float64]) -> None:
        """Set the joints (n, J) [rad] and compute poses, without moving time."""
        self._qpos[:, self.scene.qpos_index] = joint_positions
        self.batch.forward(stage=_POSES)

    def get_state(self) -> NDArray[np.float64]:
        """Copy everything the physics continues from, (n, S)."""
        return self.batch.state.copy()

    def set_state(self, state: NDArray[np.float64]) -> None:
        """Continue from a state of ``get_state``, (n, S)."""
        self.batch.state[:] = state
        self.batch.forward(stage=_POSES)
