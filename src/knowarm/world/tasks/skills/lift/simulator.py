"""Simulator of the lifting task: fingers that move, and solid objects that are free to move."""

import numpy as np
from mujoco import MjData, mj_comPos, mj_kinematics, mjtStage
from numpy.linalg import norm
from scipy.spatial.transform import Rotation

from knowarm.arrays import Floats, Indices, Integers, Mask
from knowarm.world.backend import MujocoSimulator
from knowarm.world.scene.compose import CONTROL_PERIOD_S
from knowarm.world.tasks.skills.lift.model import FINGERS, LiftScene

PARKED_M = (
    1e6  # Height from which hidden objects fall for 4,500 steps and touch nothing [m]
)
NEAR_M = 0.25  # Distance of gripper and objects' centres of mass from which fingers may grip [m]
FREE_SUBSTEPS = 10  # Physics steps of a control period in which nothing can be gripped
FAST_M_S = (
    10.0  # Speed of a centre of mass from which a control period is simulated again
)
FINE_SUBSTEPS = 100  # Its physics steps then
START_S = 1e6  # Time at which episodes start; MuJoCo sets it to 0 where it resets a simulation
TOUCH_STAGE = mjtStage.mjSTAGE_ACC.value  # Touch sensors read the forces of contacts


class LiftSimulator(MujocoSimulator):
    """Physics of n copies of a scene in which objects are lifted; the fingers are the last joint.

    Hidden objects fall far above the robot. Where nothing can be gripped, a control period takes
    ``free_substeps`` physics steps instead of those of the model's time step. Where it becomes
    unstable (an arm that jams an object against the support may hurl it away at any speed), it is
    simulated again in ``FINE_SUBSTEPS``.
    """

    def __init__(
        self,
        scene: LiftScene,
        num_envs: int,
        num_threads: int = 0,
        *,
        free_substeps: int = FREE_SUBSTEPS,
    ) -> None:
        model = scene.model
        joints = scene.num_joints
        # One servo per joint, and one of the second finger, which follows the first one's target
        self._servo_joint = np.arange(joints + 1).clip(max=joints - 1)
        shares = np.array(scene.robot.finger_shares)
        self._ratios = shares / shares[0]
        self._servo_ratio = np.append(np.ones(joints), self._ratios[1])
        super().__init__(scene, num_envs, num_threads)
        self._lift_scene = scene
        self._rows = np.arange(num_envs)
        self._free_substeps = free_substeps
        self._substeps = round(CONTROL_PERIOD_S / model.opt.timestep)
        self._stage = TOUCH_STAGE
        self._timestep = self.batch.expand("opt.timestep")
        self._time = self.batch.bind("time")
        self._centre = self.batch.bind("xipos")
        self._touch = self.batch.bind("sensordata").reshape(num_envs, -1, len(FINGERS))
        self._finger_qpos = model.jnt_qposadr[
            [model.joint(name).id for name in FINGERS]
        ]
        first_dof = model.body_dofadr[scene.bodies]
        # Indices in qvel of each target's velocity, (K, 3)
        self._target_qvel = first_dof[:, None] + np.arange(3)
        # Indices in qpos of each target's pose, (K, 7)
        self._target_qpos = scene.object_qpos[:, None] + np.arange(7)
        data = MjData(model)
        data.qpos[self._target_qpos] = scene.rest
        mj_kinematics(model, data)
        mj_comPos(model, data)
        # Centres of mass of objects that stand on the support, x and y from their place, (K, 3)
        self._rest_centre = data.xipos[scene.bodies].copy()

    @property
    def unstable(self) -> Mask:
        """Whether the physics of the episode has become unstable, (n,): its state means nothing."""
        return self._time < START_S

    def centre(self, targets: Integers) -> Floats:
        """Return the centre of mass of one target per environment, world, (n, 3) [m]."""
        return self._centre[self._rows, self._lift_scene.bodies[targets]]

    def place(self, targets: Integers) -> Floats:
        """Return x and y of one target per environment, (n, 2) [m]."""
        return self._qpos[self._rows[:, None], self._target_qpos[targets, :2]]

    def rise(self, targets: Integers) -> Floats:
        """Return how far each target's centre of mass is above where it stood, (n,) [m]."""
        return self.centre(targets)[:, 2] - self._rest_centre[targets, 2]

    def displacement(self, targets: Integers, places: Floats) -> Floats:
        """Return how far each target's centre of mass is from where it stood, (n,) [m].

        ``places`` are the x and y at which they stood, (n, 2) [m].
        """
        rest = self._rest_centre[targets]
        rest[:, :2] += places
        return norm(self.centre(targets) - rest, axis=1)

    def pose(self, targets: Integers) -> tuple[Floats, Floats]:
        """Return origin (n, 3) [m] and rotation (n, 3, 3) of one target per environment, world."""
        pose = self._qpos[self._rows[:, None], self._target_qpos[targets]]
        rotation = Rotation.from_quat(pose[:, 3:], scalar_first=True)
        return pose[:, :3], rotation.as_matrix()

    def set_pose(
        self, ids: Indices, targets: Integers, origin: Floats, matrix: Floats
    ) -> None:
        """Set the pose of one target in each of some environments (k,); see `pose`."""
        quaternion = Rotation.from_matrix(matrix).as_quat(scalar_first=True)
        pose = np.column_stack([origin, quaternion])
        self._qpos[ids[:, None], self._target_qpos[targets]] = pose

    def touched(self, targets: Integers) -> Mask:
        """Return whether both fingers touch one target per environment, (n,)."""
        return (self._touch[self._rows, targets] > 0).all(axis=1)

    def released(self, targets: Integers) -> Mask:
        """Return whether no finger touches one target per environment, (n,)."""
        return (self._touch[self._rows, targets] == 0).all(axis=1)

    def _place_targets(
        self, ids: Indices, position: Floats, visible: Mask | None
    ) -> None:
        """Put the targets on their support, or far above, and the second finger as the first."""
        self._time[ids] = START_S
        rows = ids[:, None]
        first = self._qpos[rows, self._finger_qpos[:1]]
        self._qpos[rows, self._finger_qpos] = first * self._ratios
        poses = np.repeat(self._lift_scene.rest[None], len(ids), axis=0)
        poses[..., :2] = position
        if visible is not None:
            # Each at a height of its own, so that they do not touch each other
            heights = PARKED_M * np.arange(1, len(self._target_qpos) + 1)
            poses[..., 2] += heights * ~visible
        self._qpos[rows[:, None], self._target_qpos] = poses

    def _set_servos(self, ids: Indices | slice, joint_targets: Floats) -> None:
        """Set the servos' targets; that of the second finger follows the first one's."""
        self._ctrl[ids] = joint_targets[:, self._servo_joint] * self._servo_ratio

    def step(self, joint_targets: Floats, ids: Indices | None = None) -> None:
        """Advance by a control period to joint targets (n, J) [rad].

        Contacts of a grip need small physics steps; elsewhere the few of ``free_substeps`` do.
        Of environments (m,), by default of all.
        """
        if ids is None:
            ids = self._rows
        self._set_servos(slice(None), joint_targets)
        centres = self._centre[:, self._lift_scene.bodies]
        distance = norm(centres - self.tcp_position[:, None], axis=2).min(axis=1)
        can_grip = (distance < NEAR_M) & self._may_grip(joint_targets)
        self._advance(ids[~can_grip[ids]], self._free_substeps)
        self._advance(ids[can_grip[ids]], self._substeps)

    def set_joints(
        self, joint_positions: Floats, env_ids: Indices | None = None
    ) -> None:
        """As `MujocoSimulator.set_joints`, the second finger as the first."""
        rows = np.arange(len(joint_positions)) if env_ids is None else env_ids
        fingers = joint_positions[:, -1:] * self._ratios
        self._qpos[rows[:, None], self._finger_qpos] = fingers
        super().set_joints(joint_positions, env_ids)

    def _may_grip(self, joint_targets: Floats) -> Mask:
        """Return where the fingers are closing or closed, (n,)."""
        return joint_targets[:, -1] > 0

    def _advance(self, ids: Indices, substeps: int) -> None:
        """Advance environments (k,) by a control period in a number of physics steps."""
        if not len(ids):
            return
        was_stable = ~self.unstable[ids]
        before = self.batch.state[ids]
        self._simulate(ids, substeps)
        again = was_stable & self._is_astray(ids)
        if again.any():
            ids = ids[again]
            self.batch.state[ids] = before[again]
            self._simulate(ids, FINE_SUBSTEPS)
            self._time[ids[self._is_astray(ids)]] = 0.0

    def _simulate(self, ids: Indices, substeps: int) -> None:
        """Simulate a control period of environments (k,) in physics steps of the same length."""
        self._timestep[ids] = CONTROL_PERIOD_S / substeps
        self.batch.step(ids=ids, nstep=substeps, stage=self._stage)

    def _is_astray(self, ids: Indices) -> Mask:
        """Return where MuJoCo has reset the simulation, or an object is too fast, (k,)."""
        rows = ids[:, None]
        speed = norm(self._qvel[rows[:, None], self._target_qvel], axis=2)
        is_here = self._qpos[rows, self._target_qpos[:, 2]] < PARKED_M / 2
        return self.unstable[ids] | (is_here & (speed > FAST_M_S)).any(axis=1)
