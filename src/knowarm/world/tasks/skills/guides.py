"""Guides: paths by inverse kinematics, solved once per episode from what is known as it starts."""

from typing import ClassVar, NamedTuple, Self

import numpy as np

from knowarm.arrays import Floats, Integers, Mask
from knowarm.errors import UserError
from knowarm.world.scene.scene import Scene
from knowarm.world.tasks.skills.ik import InverseKinematics
from knowarm.world.tasks.state import EpisodeState

APPROACH_M = 0.10  # Length of the straight path to the goal frame
WAYPOINTS = 8  # Poses of this path
NEAR = 0.05  # Joints within this share of the largest step of a pose have passed it
PASSES = 3  # Points that are passed in one step at most
DESTINATION = "destination"
"""Array of a skill's memory: where the object has to be put; fact: the name of that place."""


class Sight(NamedTuple):
    """What is known of n episodes as they start: the truth, or what an image shows."""

    joints: Floats
    """Angle of each joint, (n, J) [rad]."""
    position: Floats
    """Point that the gripper has to reach, world, (n, 3) [m]."""
    matrix: Floats
    """Rotation from goal frame to world, row-major, (n, 9)."""
    objects: Integers
    """Visible objects, the one that is meant first, (n, m)."""
    places: Floats
    """Their x and y, (n, m, 2) [m]."""
    destination: Floats | None = None
    """x and y of where the one that is meant has to be put, (n, 2) [m]; None: nowhere."""
    decided: Mask | None = None
    """Whether what is known decides for the destination, or else it is a guess, (n,); None: it
    does."""

    @classmethod
    def true(cls, state: EpisodeState) -> Self:
        """Return what the simulator knows."""
        return cls(
            joints=state.simulator.joint_positions,
            position=state.goal_position,
            matrix=state.goal_matrix,
            objects=state.objects,
            places=state.positions,
            destination=state.memory.get(DESTINATION),
        )


class JointPath:
    """Paths of n arms: joint targets that each passes one after the other.

    Args:
        points: the joint targets, (n, W, J) [rad]; a point without a pause before one that is the
            same is left out.
        largest_step: of a joint [rad].
        tolerance: largest error of a joint at which each point is passed [largest steps], (W,).
        pause: steps that the arm waits there, (W,).
    """

    def __init__(
        self,
        points: Floats,
        largest_step: float,
        tolerance: Floats | None = None,
        pause: Integers | None = None,
    ) -> None:
        count = points.shape[1]
        tolerance = np.full(count, NEAR) if tolerance is None else tolerance
        pause = np.zeros(count, np.int64) if pause is None else pause
        is_next = np.ones(points.shape[:2], bool)
        is_next[:, :-1] = (points[:, :-1] != points[:, 1:]).any(axis=2)
        is_next |= pause > 0
        order = np.argsort(~is_next, axis=1, kind="stable")
        self._rows = np.arange(len(points))
        self.points = points[self._rows[:, None], order]
        self._largest = largest_step
        self._tolerance = tolerance[order]
        self._pause = pause[order]
        self._last = is_next.sum(axis=1) - 1
        self._next = np.zeros(len(points), np.int64)
        self._waited = np.zeros(len(points), np.int64)

    def has_ended(self, joint_targets: Floats) -> Mask:
        """Return where joint targets (n, J) are near the last point, (n,)."""
        _, is_near = self._steps_to_next(joint_targets)
        return is_near & (self._next == self._last)

    def error(self, joint_targets: Floats) -> Floats:
        """Return the way from joint targets to the next point in largest steps, (n, J)."""
        for _ in range(PASSES):
            _, is_near = self._steps_to_next(joint_targets)
            is_passed = is_near & (self._waited >= self._pause[self._rows, self._next])
            self._waited = np.where(is_passed, 0, self._waited)
            self._next = np.minimum(self._next + is_passed, self._last)
        steps, is_near = self._steps_to_next(joint_targets)
        self._waited = self._waited + is_near
        return steps

    def _steps_to_next(self, joint_targets: Floats) -> tuple[Floats, Mask]:
        """Return the way to the next point (n, J), and whether that is near, (n,)."""
        steps = (self.points[self._rows, self._next] - joint_targets) / self._largest
        tolerance = self._tolerance[self._rows, self._next]
        return steps, np.abs(steps).max(axis=1) < tolerance


class Guide:
    """Moves every joint straight to its angle at the goal frame.

    Args:
        scene: robot and objects.
        largest_step: of a joint [rad].
        angle_deg: between gripper and goal frame, below which it counts as reached.
        ignore_roll: whether that angle ignores the rotation about the approach axis.
        seed: of the solver's starts.

    Raises:
        UserError: the scene moves more than the robot's joints.
    """

    moves_fingers: ClassVar[bool] = False
    """Whether its paths close the fingers."""

    def __init__(
        self,
        scene: Scene,
        largest_step: float,
        angle_deg: float,
        ignore_roll: bool,
        seed: int = 0,
    ) -> None:
        if not self.moves_fingers and scene.joint_names != scene.robot.joints:
            raise UserError(
                "The path to a grasp frame does not tell what else moves: "
                f"{', '.join(scene.joint_names[len(scene.robot.joints) :])}. Override "
                "`Skill.guide` with a `Guide` that does."
            )
        self._scene = scene
        self._largest = largest_step
        self._seed = seed
        self._angle_deg = angle_deg
        self._ignore_roll = ignore_roll
        self._solver = self._make_solver()

    def path(self, sight: Sight) -> JointPath:
        """Solve the path of every episode."""
        goal = self._solver.solve(sight.position, sight.matrix, sight.joints).joints
        return JointPath(goal[:, None], self._largest)

    def _make_solver(self, starts: int = 8) -> InverseKinematics:
        """Make a solver with a number of starts."""
        return InverseKinematics.within_angle(
            self._scene,
            self._angle_deg,
            self._ignore_roll,
            starts=starts,
            seed=self._seed,
        )


class StraightApproach(Guide):
    """Moves to a pose behind the goal frame, and then straight along the frame's z axis.

    On the shortest path of the joints, fingers can hit the object.
    """

    def path(self, sight: Sight) -> JointPath:
        """Solve the path of every episode."""
        goal = super().path(sight).points[:, -1]
        back = -sight.matrix.reshape(-1, 3, 3)[:, :, 2]
        distances = np.linspace(0.0, APPROACH_M, WAYPOINTS + 1)[1:]
        shifts = distances[:, None, None] * back
        solver = self._make_solver(starts=1)
        approach = solver.solve_path(sight.position, sight.matrix, goal, shifts)
        points = np.concatenate([approach[:, ::-1], goal[:, None]], axis=1)
        return JointPath(points, self._largest)
