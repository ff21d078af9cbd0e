"""Inverse kinematics by damped least squares from several starts."""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from mujoco import mjtJoint

from knowarm.arrays import Floats, Mask
from knowarm.world.backend import Dynamics, MujocoSimulator
from knowarm.world.scene.compose import ROBOT_PREFIX
from knowarm.world.scene.scene import Scene
from knowarm.world.tasks.reward import SUCCESS_ANGLE_DEG, measure
from knowarm.world.tasks.state import EpisodeState, Frames

ITERATIONS = 80
DAMPING = 0.05
DAMPED = DAMPING**2 * np.eye(6)
MAX_STEP_RAD = 0.3
SETTLED_RAD = 1e-5  # A step below which the iterations of a pose end
ATTEMPTS = 6  # Sets of random starts tried for poses that are not reached
FEW_POSES = 64  # Poses for which one thread is faster than a pool of them
ROTATION_WEIGHT = 0.05
"""Weight of the direction beside the position where the roll is ignored [m/rad]."""

REACHED_M = 0.01
REACHED_DEG = 3.0
"""Errors below which a pose counts as reached; far below the task's thresholds."""
# Distance of an easier orientation from its threshold [deg]
MARGIN_DEG = REACHED_DEG + 2.0

# Axes after x, y and z, and those after these
FOLLOWING = np.array([1, 2, 0])
LAST = np.array([2, 0, 1])


@dataclass(frozen=True)
class IKSolution:
    """The best joint angles found for n gripper poses."""

    joints: Floats  # Joint angles within the joints' ranges, (n, J) [rad]
    distance: Floats  # Distance to the desired position [m], (n,)
    angle: Floats  # Angle to the desired orientation [deg], (n,)
    contact: Mask  # Whether the robot is in contact with floor or table, (n,)

    def within(self, distance_m: float, angle_deg: float) -> Mask:
        """Return which poses are reached within thresholds and without contact, (n,)."""
        return (self.distance < distance_m) & (self.angle < angle_deg) & ~self.contact


class InverseKinematics:
    """Damped least squares from several starts (Nakamura and Hanafusa 1986).

    dq = J' (J J' + lambda^2 I)^-1 e, with J the Jacobian of the gripper (6, J) and e its position
    and rotation error (6,), clipped to the joints' ranges after every iteration. The starts per
    pose are the given joints, home and random ones; among the solutions without contact, the one
    nearest to the first start is selected. ``ignore_roll`` leaves the rotation about the approach
    axis open, and puts the position first where an arm has too few joints for both. An error of
    ``eased_deg`` of the orientation does not count, so that the nearest such pose is selected.
    A pose is reached within 1 cm and ``reached_deg``: 3 degrees and those.
    """

    def __init__(
        self,
        scene: Scene,
        starts: int = 8,
        seed: int = 0,
        *,
        ignore_roll: bool = False,
        eased_deg: float = 0.0,
    ) -> None:
        self.scene = scene
        self._starts = starts
        self._seed = seed
        self._ignore_roll = ignore_roll
        self._eased_deg = eased_deg
        self.reached_deg = REACHED_DEG + eased_deg
        model = scene.model
        joints = [model.joint(ROBOT_PREFIX + name).id for name in scene.robot.joints]
        self._joints = np.array(joints)
        self._is_hinge = model.jnt_type[self._joints] == mjtJoint.mjJNT_HINGE
        self._kept: dict[Dynamics, MujocoSimulator] = {}

    @classmethod
    def of_task(cls, scene: Scene, state: EpisodeState, **options: Any) -> Self:
        """Make the solver of a task's episodes, which uses what an easier orientation allows."""
        return cls.within_angle(
            scene, float(state.limits[1]), state.ignore_roll, **options
        )

    @classmethod
    def within_angle(
        cls, scene: Scene, angle_deg: float, ignore_roll: bool, **options: Any
    ) -> Self:
        """Make the solver of a task with a success angle [deg]."""
        eased_deg = 0.0
        if ignore_roll:
            widened = 2 * (angle_deg - SUCCESS_ANGLE_DEG)
            eased_deg = max(eased_deg, min(widened, angle_deg - MARGIN_DEG))
        return cls(scene, ignore_roll=ignore_roll, eased_deg=eased_deg, **options)

    def solve(
        self, position: Floats, matrix: Floats, start: Floats, attempts: int = ATTEMPTS
    ) -> IKSolution:
        """Find joint angles for n gripper poses, near the angles ``start`` (n, J) [rad].

        Positions (n, 3) [m] and row-major rotations (n, 9) are those of the gripper in the world.
        Poses that are not reached are tried from ``attempts`` sets of random starts. With one,
        positions can be those of T poses each, (T, n, 3), and so are the joint angles; rotations
        and ``start`` broadcast.
        """
        solution = self._solve_once(position, matrix, start, self._seed)
        for attempt in range(1, attempts):
            missed = np.flatnonzero(~solution.within(REACHED_M, self.reached_deg))
            if not len(missed):
                break
            again = self._solve_once(
                position[missed], matrix[missed], start[missed], self._seed + attempt
            )
            is_better = again.within(REACHED_M, self.reached_deg)
            for name, values in vars(solution).items():
                values[missed[is_better]] = getattr(again, name)[is_better]
        return solution

    def solve_path(
        self, position: Floats, matrix: Floats, start: Floats, shifts: Floats
    ) -> Floats:
        """Solve for poses moved by each of W shifts, from the solution before, (n, W, J) [rad].

        Shifts can be those of T poses each, (W, T, n, 3), and so are the joint angles.
        """
        path = []
        for shift in shifts:
            start = self.solve(position + shift, matrix, start, attempts=1).joints
            path.append(start)
        return np.stack(path, axis=-2)

    def pose(self, joints: Floats) -> Frames:
        """Compute positions (n, 3) [m] and row-major rotations (n, 9) at joint angles (n, J)."""
        n = len(joints)
        simulation = self._simulator(n, "kinematic")
        simulation.set_joints(joints, np.arange(n))
        return simulation.tcp_position[:n].copy(), simulation.tcp_matrix[:n].copy()

    def _simulator(self, n: int, dynamics: Dynamics) -> MujocoSimulator:
        """Return n simulations or more, which are kept where they are few."""
        if n > FEW_POSES:
            return MujocoSimulator(self.scene, n, dynamics=dynamics)
        if dynamics not in self._kept:
            self._kept[dynamics] = MujocoSimulator(self.scene, FEW_POSES, 1, dynamics)
        return self._kept[dynamics]

    def _solve_once(
        self, position: Floats, matrix: Floats, start: Floats, seed: int
    ) -> IKSolution:
        shape = (self._starts, *position.shape[:-1])
        n = position.size // 3
        lower = self.scene.joint_lower
        upper = self.scene.joint_upper
        joints = len(lower)
        generator = np.random.default_rng(seed)
        # All poses share the random starts, so a solution depends on its own pose only.
        starts = generator.uniform(lower, upper, (self._starts, 1, joints))
        q = np.repeat(starts, n, axis=1).reshape(*shape, joints)
        q[0] = start
        if self._starts > 1:
            q[1] = self.scene.home
        start = np.broadcast_to(start, q.shape).reshape(-1, joints)
        position = np.broadcast_to(position, (*shape, 3)).reshape(-1, 3)
        matrix = np.broadcast_to(matrix, (*shape, 9)).reshape(-1, 9)
        q = q.reshape(-1, joints)
        self._improve(q, position, matrix)
        q = self._unwind(q, start)
        count = len(q)
        simulation = self._simulator(count, "dynamic")
        # Bound before the call: what is bound after one holds zeros until the next.
        contacts = simulation.batch.bind("ncon").reshape(-1)
        simulation.set_joints(q, np.arange(count))
        distance, angle = measure(
            simulation.tcp_position[:count],
            simulation.tcp_matrix[:count],
            position,
            matrix,
            self._ignore_roll,
        )
        change = np.abs(q - start).max(axis=1)
        touches = contacts[:count] > 0
        tilted = (angle - self._eased_deg).clip(min=0.0) / REACHED_DEG
        missed = (distance / REACHED_M + tilted).clip(min=1.0)
        # Smallest change first, then solutions in contact, then poses that are not reached.
        cost = change + 100.0 * touches + 1000.0 * missed
        best = cost.reshape(self._starts, n).argmin(axis=0) * n + np.arange(n)
        best = best.reshape(shape[1:])
        return IKSolution(q[best], distance[best], angle[best], touches[best])

    def _improve(self, q: Floats, position: Floats, matrix: Floats) -> None:
        """Iterate joint angles (n, J) in place until each has settled."""
        simulation = self._simulator(len(q), "kinematic")
        anchors = simulation.batch.bind("xanchor")
        axes = simulation.batch.bind("xaxis")
        active = np.arange(len(q))
        for _ in range(ITERATIONS):
            old = q[active]
            simulation.set_joints(old, active)
            tcp = simulation.tcp_position[active]
            goal = matrix[active]
            error = _pose_error(
                tcp, simulation.tcp_matrix[active], position[active], goal
            )
            joint = (active[:, None], self._joints)
            jacobian = self._jacobian(tcp, anchors[joint], axes[joint])
            if self._ignore_roll:
                error, jacobian = _without_roll(error, jacobian, goal)
            transposed = jacobian.transpose(0, 2, 1)
            damped = jacobian @ transposed + DAMPED
            step = (transposed @ np.linalg.solve(damped, error[..., None]))[..., 0]
            new = old + step.clip(-MAX_STEP_RAD, MAX_STEP_RAD)
            new = new.clip(self.scene.joint_lower, self.scene.joint_upper)
            q[active] = new
            active = active[np.abs(new - old).max(axis=1) > SETTLED_RAD]
            if not len(active):
                break

    def _jacobian(self, tcp: Floats, anchors: Floats, axes: Floats) -> Floats:
        """Return the Jacobians of the gripper (n, 6, J) from anchors and axes (n, J, 3)."""
        arm = tcp[:, None] - anchors
        turning = axes.take(FOLLOWING, -1) * arm.take(LAST, -1)
        turning -= axes.take(LAST, -1) * arm.take(FOLLOWING, -1)
        is_hinge = self._is_hinge[:, None]
        moving = np.where(is_hinge, turning, axes)
        rotating = np.where(is_hinge, axes, 0.0)
        return np.concatenate([moving, rotating], axis=2).transpose(0, 2, 1)

    def _unwind(self, q: Floats, start: Floats) -> Floats:
        """Shift hinges by whole turns to the angle nearest to the start."""
        turns = np.round((q - start) / (2 * np.pi)) * self._is_hinge
        unwound = q - 2 * np.pi * turns
        is_inside = (unwound >= self.scene.joint_lower) & (
            unwound <= self.scene.joint_upper
        )
        return np.where(is_inside, unwound, q)


def _without_roll(
    error: Floats, jacobian: Floats, matrix: Floats
) -> tuple[Floats, Floats]:
    """Drop the rotation about the approach axis from errors (n, 6) and Jacobians (n, 6, J)."""
    axis = matrix.reshape(-1, 3, 3)[:, :, 2]
    across = ROTATION_WEIGHT * (np.eye(3) - axis[:, :, None] * axis[:, None, :])
    error[:, 3:] = (across @ error[:, 3:, None])[..., 0]
    turning = across @ jacobian[:, 3:]
    return error, np.concatenate([jacobian[:, :3], turning], axis=1)


def _pose_error(
    tcp: Floats, tcp_matrix: Floats, position: Floats, matrix: Floats
) -> Floats:
    """Return position error [m] and rotation vector [rad] to the desired pose, (n, 6), world."""
    n = len(position)
    turn = matrix.reshape(n, 3, 3) @ tcp_matrix.reshape(n, 3, 3).transpose(0, 2, 1)
    skew = turn[:, LAST, FOLLOWING] - turn[:, FOLLOWING, LAST]
    sine = np.sqrt((skew * skew).sum(axis=1, keepdims=True))
    cosine = np.trace(turn, axis1=1, axis2=2)[:, None] - 1.0
    # At half a turn the skew part does not define the axis; any axis makes progress.
    axis = np.where(sine > 1e-9, skew / np.maximum(sine, 1e-9), [1.0, 0.0, 0.0])
    return np.concatenate([position - tcp, axis * np.arctan2(sine, cosine)], axis=1)
