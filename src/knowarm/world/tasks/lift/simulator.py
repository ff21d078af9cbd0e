"""Simulator of the lifting task: fingers that move, and solid objects that are free to move."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from knowarm.arrays import Floats, Integers, Mask
from knowarm.world.backend import MujocoSimulator
from knowarm.world.scene.compose import CONTROL_PERIOD_S
from knowarm.world.scene.scene import Scene
from knowarm.world.tasks.lift.model import FINGERS

PARKED_M = 1e6  # Height from which hidden objects fall, for 4,500 steps, and touch nothing [m]

NEAR_M = 0.25  # Distance of gripper and objects' centres of mass from which fingers may grip [m]
SUBSTEPS = 10  # Of a control period where nothing can be gripped, else those of the model
_CONTACTS = mujoco.mjtStage.mjSTAGE_ACC.value  # The sensors of touch need the contacts' forces


class LiftSimulator(MujocoSimulator):
    """Physics of n copies of a solid scene, see `load_scene`; the fingers are the last joint.

    Hidden objects fall far above the robot.
    """

    def __init__(self, scene: Scene, num_envs: int, num_threads: int = 0) -> None:
        super().__init__(scene, num_envs, num_threads)
        assert scene.lifting is not None
        self.lifting = lifting = scene.lifting
        model = lifting.model
        self._substeps = round(CONTROL_PERIOD_S / model.opt.timestep)
        self._stage = _CONTACTS
        self._timestep = self.batch.expand("opt.timestep")
        self._centre = self.batch.bind("xipos")
        self._touch = self.batch.bind("sensordata")
        self._fingers = model.jnt_qposadr[[model.joint(name).id for name in FINGERS]]
        data = mujoco.MjData(model)
        for start, rest in zip(lifting.object_qpos, lifting.rest, strict=True):
            data.qpos[start : start + 7] = rest
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        self._rest_height = data.xipos[lifting.bodies, 2].copy()

    def centre(self, targets: Integers) -> Floats:
        """Return the centre of mass of one target per environment, world, (n, 3) [m]."""
        return self._centre[np.arange(self.num_envs), self.lifting.bodies[targets]]

    def place(self, targets: Integers) -> Floats:
        """Return x and y of one target per environment, (n, 2) [m]."""
        start = self.lifting.object_qpos[targets]
        return self._qpos[np.arange(self.num_envs)[:, None], start[:, None] + np.arange(2)]

    def rise(self, targets: Integers) -> Floats:
        """Return how far each target's centre of mass is above where it stood, (n,) [m]."""
        return np.asarray(self.centre(targets)[:, 2] - self._rest_height[targets])

    def touched(self, targets: Integers) -> Mask:
        """Return whether both fingers touch one target per environment, (n,)."""
        contacts = self._touch.reshape(self.num_envs, -1, len(FINGERS))
        return np.asarray((contacts[np.arange(self.num_envs), targets] > 0).all(axis=1))

    def reset(
        self,
        env_ids: NDArray[np.intp],
        joint_targets: Floats,
        target_position: Floats,
        distractor_position: Floats | None = None,
        visible: Mask | None = None,
    ) -> None:
        """Put environments (m,) at rest; see `MujocoSimulator.reset`."""
        ids, lifting = env_ids, self.lifting
        self._qpos[ids[:, None], self._fingers] = joint_targets[:, -1:]
        for k, start in enumerate(lifting.object_qpos):
            pose = np.tile(lifting.rest[k], (len(ids), 1))
            pose[:, :2] = target_position[:, k]
            if visible is not None:
                pose[:, 2] += PARKED_M * (k + 1) * ~visible[:, k]
            self._qpos[ids[:, None], start + np.arange(7)] = pose
        super().reset(ids, joint_targets, target_position, distractor_position, visible)

    def step(self, joint_targets: Floats, substeps: int | None = None) -> None:
        """Advance by a control period to joint targets (n, J) [rad]; a grip takes small steps."""
        self._set_servos(slice(None), joint_targets)
        centres = self._centre[:, self.lifting.bodies]
        near = np.linalg.norm(centres - self.tcp_position[:, None], axis=2).min(axis=1) < NEAR_M
        grips = near & (joint_targets[:, -1] > 0)
        for each, count in ((~grips, SUBSTEPS), (grips, self._substeps)):
            if each.any():
                self._timestep[each] = CONTROL_PERIOD_S / count
                self.batch.step(ids=np.flatnonzero(each), nstep=count, stage=self._stage)
