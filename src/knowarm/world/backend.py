"""MuJoCo backend: a batch of simulations on a pool of CPU threads, in float64."""

import copy
from typing import Literal

from mujoco import mjtDisableBit, mjtStage

from knowarm.arrays import Floats, Indices, Mask
from knowarm.cores import available_cores
from knowarm.world.batch import make_batch
from knowarm.world.rebuilt import Rebuilt
from knowarm.world.scene.compose import SUBSTEPS
from knowarm.world.scene.scene import Scene, target_places

Dynamics = Literal["dynamic", "kinematic"]
"""Position servos with inertia and contacts, or joint angles set exactly."""

_POSES = mjtStage.mjSTAGE_POS.value


class MujocoSimulator(Rebuilt):
    """Physics of n copies of a scene; results depend on neither n nor the thread count.

    "dynamic" moves the joints by position servos with ``SUBSTEPS`` physics steps per action;
    "kinematic" sets them exactly and computes poses only. Poses are refreshed by ``reset``,
    ``step`` and ``set_state``; array attributes are live views. 0 threads are one per core.
    """

    substeps = SUBSTEPS
    """Physics steps per action. `examples/ros_robot.py` takes single ones."""

    def __init__(
        self,
        scene: Scene,
        num_envs: int,
        num_threads: int = 0,
        dynamics: Dynamics = "dynamic",
    ) -> None:
        self.scene = scene
        self.num_envs = num_envs
        self.dynamics = dynamics
        model = scene.model
        if dynamics == "kinematic":
            # Poses need no contacts and no constraints.
            model = copy.copy(model)
            model.opt.disableflags |= int(mjtDisableBit.mjDSBL_CONTACT)
            model.opt.disableflags |= int(mjtDisableBit.mjDSBL_CONSTRAINT)
        self.batch = make_batch(model, num_envs, num_threads or available_cores())
        self._stage = _POSES
        bind = self.batch.bind
        self._qpos = bind("qpos")
        self._qvel = bind("qvel")
        self._ctrl = bind("ctrl")
        self._warmstart = bind("qacc_warmstart")
        self._mocap = bind("mocap_pos")
        self._site_position = bind("site_xpos")
        self._site_matrix = bind("site_xmat")
        self.geom_position: Floats = bind("geom_xpos")
        self.geom_matrix: Floats = bind("geom_xmat")

    @property
    def joint_positions(self) -> Floats:
        """Current joint angles, a copy, (n, J) [rad]."""
        return self._qpos[:, self.scene.qpos_index]

    @property
    def tcp_position(self) -> Floats:
        """Position of the gripper, world, (n, 3) [m]."""
        return self._site_position[:, self.scene.tcp_site]

    @property
    def tcp_matrix(self) -> Floats:
        """Rotation from gripper to world, row-major, (n, 9)."""
        return self._site_matrix[:, self.scene.tcp_site]

    def reset(
        self,
        env_ids: Indices,
        joint_targets: Floats,
        target_position: Floats,
        distractor_position: Floats | None = None,
        visible: Mask | None = None,
    ) -> None:
        """Put environments (m,) at rest at joint angles (m, J) [rad].

        Positions are x and y [m] of the K targets, also of hidden ones, and of the D distractors.
        ``visible`` tells which targets are not hidden, (m, K), where that matters to the physics.
        """
        rows = env_ids[:, None]
        self._qpos[rows, self.scene.qpos_index] = joint_targets
        self._qvel[env_ids] = 0.0
        self._warmstart[env_ids] = 0.0
        self._set_servos(env_ids, joint_targets)
        self._place_targets(env_ids, target_position, visible)
        if distractor_position is not None:
            self._mocap[rows, self.scene.distractor_mocap, :2] = distractor_position
        self.batch.forward(ids=env_ids, stage=self._stage)

    def step(self, joint_targets: Floats, ids: Indices | None = None) -> None:
        """Advance by ``substeps`` to joint targets (n, J) [rad].

        Of environments (m,), by default of all.
        """
        if self.dynamics == "kinematic":
            self.set_joints(joint_targets)
        else:
            self._set_servos(slice(None), joint_targets)
            self.batch.step(ids=ids, nstep=self.substeps, stage=self._stage)

    def set_joints(
        self, joint_positions: Floats, env_ids: Indices | None = None
    ) -> None:
        """Set the joint angles (m, J) [rad] and compute poses without advancing time.

        Of environments (m,), by default of all.
        """
        rows = slice(None) if env_ids is None else env_ids[:, None]
        self._qpos[rows, self.scene.qpos_index] = joint_positions
        self.batch.forward(ids=env_ids, stage=_POSES)

    def get_state(self) -> Floats:
        """Copy MuJoCo's state, which includes servo targets and object positions, (n, S)."""
        return self.batch.state.copy()

    def set_state(self, state: Floats) -> None:
        """Restore a state of ``get_state``."""
        self.batch.state[:] = state
        self.batch.forward(stage=self._stage)

    def _place_targets(
        self, ids: Indices, position: Floats, visible: Mask | None
    ) -> None:
        """Put the targets on their support; see `reset`."""
        places = target_places(self.scene, position)
        self._mocap[ids[:, None], self.scene.target_mocap] = places

    def _set_servos(self, ids: Indices | slice, joint_targets: Floats) -> None:
        self._ctrl[ids] = joint_targets
