"""Gripper poses go in; joint angles that reach them come out, by damped least squares."""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from knowarm.world.backends.mujoco import MujocoSimulator
from knowarm.world.scene import Scene
from knowarm.world.tasks.reward import measure

ITERATIONS = 80
DAMPING = 0.05
MAX_STEP_RAD = 0.3
ATTEMPTS = 6
GOOD_M, GOOD_DEG = 0.01, 3.0
"""What counts as there; far within any threshold of the task."""


@dataclass(frozen=True, kw_only=True)
class Reach:
    """The best joint angles found for n gripper poses."""

    joints: NDArray[np.float64]
    """(n, J) [rad], within the joints' ranges."""

    distance: NDArray[np.float64]
    """Distance left to the wanted position [m], (n,)."""

    angle: NDArray[np.float64]
    """Angle left to the wanted orientation [deg], (n,)."""

    contact: NDArray[np.bool_]
    """Whether the robot touches floor or table there, (n,)."""

    def within(self, distance_m: float, angle_deg: float) -> NDArray[np.bool_]:
        """Tell which poses are reached within thresholds and without contact, (n,)."""
        return (self.distance < distance_m) & (self.angle < angle_deg) & ~self.contact


class InverseKinematics:
    """Damped least squares from several starts at once (Nakamura and Hanafusa 1986).

    dq = J' (J J' + lambda^2 I)^-1 e, with J the Jacobian of the gripper (6, J) and e its position
    and rotation error (6,), clipped to the joints' ranges after every step. Of the starts that get
    there without touching anything, the one with the shortest way from the first start is kept.

    Args:
        scene: the robot.
        starts: starts for each pose: the given joints, then home, then random ones.
        seed: of the random starts.
    """

    def __init__(self, scene: Scene, starts: int = 8, seed: int = 0) -> None:
        self.scene = scene
        self._starts = starts
        self._seed = seed
        model = scene.model
        self._body = int(model.site_bodyid[scene.tcp_site])
        joints = [model.joint(f"robot/{name}").id for name in scene.robot.joints]
        self._is_hinge = model.jnt_type[joints] == mujoco.mjtJoint.mjJNT_HINGE
        self._dofs = model.jnt_dofadr[joints]

    def solve(
        self,
        position: NDArray[np.float64],
        matrix: NDArray[np.float64],
        start: NDArray[np.float64],
    ) -> Reach:
        """Find joint angles for n gripper poses; what fails is tried again from other starts.

        Args:
            position: wanted gripper positions, world [m], (n, 3).
            matrix: wanted rotations from gripper to world, row by row, (n, 9).
            start: joints from which the way should be short [rad], (n, J).
        """
        reach = self._solve_once(position, matrix, start, self._seed)
        for attempt in range(1, ATTEMPTS):
            missed = np.flatnonzero(~reach.within(GOOD_M, GOOD_DEG))
            if not len(missed):
                break
            again = self._solve_once(
                position[missed], matrix[missed], start[missed], self._seed + attempt
            )
            better = again.within(GOOD_M, GOOD_DEG)
            for name in ("joints", "distance", "angle", "contact"):
                getattr(reach, name)[missed[better]] = getattr(again, name)[better]
        return reach

    def _solve_once(
        self,
        position: NDArray[np.float64],
        matrix: NDArray[np.float64],
        start: NDArray[np.float64],
        seed: int,
    ) -> Reach:
        n, joints = start.shape
        lower, upper = self.scene.joint_lower, self.scene.joint_upper
        generator = np.random.default_rng(seed)
        # The same random starts for every pose: a result depends on its pose alone.
        starts = generator.uniform(lower, upper, (self._starts, 1, joints))
        q = np.repeat(starts, n, axis=1)
        q[0] = start
        if self._starts > 1:
            q[1] = self.scene.home
        q = q.reshape(-1, joints)
        position, matrix = np.tile(position, (self._starts, 1)), np.tile(matrix, (self._starts, 1))

        simulation = MujocoSimulator(self.scene, len(q))
        contacts = simulation.batch.bind("ncon")
        for _ in range(ITERATIONS):
            simulation.set_joints(q)
            error = _pose_error(simulation, position, matrix)
            translation, rotation = simulation.batch.jac(self._body, simulation.tcp_position)
            jacobian = np.concatenate([translation, rotation], axis=1)[:, :, self._dofs]
            transposed = jacobian.transpose(0, 2, 1)
            damped = jacobian @ transposed + DAMPING**2 * np.eye(6)
            step = (transposed @ np.linalg.solve(damped, error[..., None]))[..., 0]
            q = np.clip(q + np.clip(step, -MAX_STEP_RAD, MAX_STEP_RAD), lower, upper)
        q = self._unwind(q, np.tile(start, (self._starts, 1)))
        simulation.set_joints(q)
        distance, angle = measure(
            simulation.tcp_position, simulation.tcp_matrix, position, matrix, False
        )
        way = np.abs(q - np.tile(start, (self._starts, 1))).max(axis=1)
        touches = contacts.reshape(len(q)) > 0
        # Shortest way first, far behind it what touches, and last what does not get there.
        cost = way + 100.0 * touches + 1000.0 * (distance / GOOD_M + angle / GOOD_DEG).clip(min=1.0)
        best = cost.reshape(self._starts, n).argmin(axis=0) * n + np.arange(n)
        return Reach(
            joints=q[best], distance=distance[best], angle=angle[best], contact=touches[best]
        )

    def _unwind(self, q: NDArray[np.float64], start: NDArray[np.float64]) -> NDArray[np.float64]:
        """Turn hinges by whole turns to where the way from the start is shortest."""
        turns = np.round((q - start) / (2 * np.pi)) * self._is_hinge
        unwound = q - 2 * np.pi * turns
        inside = (unwound >= self.scene.joint_lower) & (unwound <= self.scene.joint_upper)
        return np.where(inside, unwound, q)


def _pose_error(
    simulation: MujocoSimulator, position: NDArray[np.float64], matrix: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Position error [m] and rotation vector [rad] from gripper to wanted pose, (n, 6), world."""
    n = len(position)
    turn = matrix.reshape(n, 3, 3) @ simulation.tcp_matrix.reshape(n, 3, 3).transpose(0, 2, 1)
    skew = np.stack(
        [
            turn[:, 2, 1] - turn[:, 1, 2],
            turn[:, 0, 2] - turn[:, 2, 0],
            turn[:, 1, 0] - turn[:, 0, 1],
        ],
        axis=1,
    )
    sine = np.linalg.norm(skew, axis=1)
    angle = np.arctan2(sine, np.trace(turn, axis1=1, axis2=2) - 1.0)
    # Half a turn away the axis is not defined by the skew part; any axis will do to get moving.
    axis = np.where(sine[:, None] > 1e-9, skew / np.maximum(sine, 1e-9)[:, None], [1.0, 0.0, 0.0])
    error = np.concatenate([position - simulation.tcp_position, axis * angle[:, None]], axis=1)
    return np.asarray(error)
