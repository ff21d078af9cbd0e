"""Teacher of placing: as that of lifting, then to the tray, where the fingers let go."""

import numpy as np
from numpy.linalg import norm

from knowarm.arrays import Floats, Mask
from knowarm.world.scene.scene import build_scene
from knowarm.world.tasks.skills.guides import DESTINATION
from knowarm.world.tasks.skills.ik import REACHED_DEG, REACHED_M, InverseKinematics
from knowarm.world.tasks.skills.lift.guide import UNREACHED, UP, rotation
from knowarm.world.tasks.skills.lift.simulator import LiftSimulator
from knowarm.world.tasks.skills.lift.teacher import LiftTeacher, followed, path_of
from knowarm.world.tasks.skills.place.tray import DOWN_M, THICK_M, is_over
from knowarm.world.tasks.skills.teacher import interpolate
from knowarm.world.tasks.state import EpisodeState

HEIGHTS_M = (0.12, 0.08, 0.04, 0.004)
"""Heights of an object above the tray on its way down; at the last one it is let go."""
TURNS_DEG = (0, 30, -30, 60, -60, 90, -90)
"""Turns of the object about the vertical on its path to the tray, of which the shortest counts."""
CARRY_POINTS = 24  # Points on the path to the tray
LOWER_POINTS = 6  # Points from one height to the next
BACK_M = (0.02, 0.05, 0.10)
"""Distances of the gripper, along its approach, from where it let go of an object."""
LOW_M = 0.012  # Rise of an object over its tray from which it may be let go
OPEN_M = 0.002  # Way of a finger from fully open at which it has opened
ARRIVED = 0.6
"""Largest error of a joint at which an object is let go [largest steps]: a student has no smaller
steps, and so stops within half of one."""


class PlaceTeacher(LiftTeacher):
    """Takes an object as `LiftTeacher`, carries it over its tray, lowers it and lets it go.

    What it does depends on the state alone, as there: with the object in its grip the arm aims at
    the point after the one of its path that is nearest.
    """

    def __init__(
        self, state: EpisodeState[LiftSimulator], tray_centres: Floats
    ) -> None:
        super().__init__(state)
        arm = build_scene(state.scene.robot, state.scene.targets[:1])
        self._solver = InverseKinematics.of_task(arm, state)
        self._trays = tray_centres
        # Past their stop, so that the largest step alone opens them all the way
        self._opened_m = -float(self._largest)
        over = [self._over_tray(centre) for centre in tray_centres]
        self._lower = np.stack(over)  # (T, K, H, A)
        back = [self._back(lower[:, -1]) for lower in self._lower]
        self._leave = np.stack(back)  # (T, K, B, A)

    def _over_tray(self, centre: Floats) -> Floats:
        """Return joint angles with each object over a tray, at each height, (K, H, A) [rad]."""
        state = self._state
        count = len(state.scene.targets)
        numbers = np.arange(count)
        middle = np.tile(state.scene.robot.rectangle_centre_m, (count, 1))
        start = self._rise[-1](numbers, middle)
        places = np.tile(centre, (count, 1))
        position, matrix = state.goal_frames(numbers, places)
        on_tray = np.append(centre, THICK_M)
        offset = position - [*centre, 0.0]
        found = np.zeros((count, len(HEIGHTS_M), start.shape[1]))
        least = np.full(count, np.inf)
        for degrees in TURNS_DEG:
            turn = rotation(2, degrees)
            goal = on_tray + offset @ turn.T
            goal_matrix = (turn @ matrix.reshape(-1, 3, 3)).reshape(-1, 9)
            joints, cost = self._downwards(goal, goal_matrix, start)
            is_shorter = cost < least
            found[is_shorter] = joints[is_shorter]
            least[is_shorter] = cost[is_shorter]
        return found

    def _downwards(
        self, position: Floats, matrix: Floats, joints: Floats
    ) -> tuple[Floats, Floats]:
        """Solve for the heights above grasp frames (K,), each from the one before.

        Returns:
            Joint angles (K, H, A) [rad], and the way to them from ``joints`` (K, A), where it is
            not reached `UNREACHED`, (K,) [rad].
        """
        cost = np.zeros(len(joints))
        path = []
        for height in HEIGHTS_M:
            solution = self._solver.solve(position + height * UP, matrix, joints)
            moved = np.abs(solution.joints - joints).max(axis=1)
            is_reached = solution.within(REACHED_M, REACHED_DEG)
            cost += np.where(is_reached, moved, UNREACHED)
            joints = solution.joints
            path.append(joints)
        return np.stack(path, axis=1), cost

    def _back(self, joints: Floats) -> Floats:
        """Return joint angles on the path back from objects let go at (K, A), (K, B, A) [rad]."""
        position, matrix = self._solver.pose(joints)
        back = -matrix.reshape(-1, 3, 3)[:, :, 2]
        shifts = np.stack([distance * back for distance in BACK_M])
        path = self._solver.solve_path(position, matrix, joints, shifts)
        return np.concatenate([joints[:, None], path], axis=1)

    def _with_object(self, joints: Floats) -> tuple[Floats, Mask]:
        """See `LiftTeacher._with_object`: on the path to the tray, at whose end they let go."""
        state = self._state
        rise = path_of(self._rise, state.target, state.positions[:, 0])
        lower = self.lowered()
        carry = _between(rise[-1:], lower[:1], CARRY_POINTS)
        lowered = _between(lower[:-1], lower[1:], LOWER_POINTS)
        path = np.concatenate([rise[:-1], *carry, *lowered, lower[-1:]])
        error = np.abs(path[-1] - joints).max(axis=1) / self._largest
        lets_go = (error < ARRIVED) | self._is_over_tray(LOW_M)
        return followed(path, joints), lets_go

    def _after_release(self, joints: Floats) -> tuple[Floats, Mask]:
        """See `LiftTeacher._after_release`: back from an object that is down over its tray."""
        leave = self.left()
        backwards = _between(leave[:-1], leave[1:], LOWER_POINTS)
        path = np.concatenate([*backwards, leave[-1:]])
        goal = followed(path, joints)
        is_open = self._simulator.joint_positions[:, -1] < OPEN_M
        goal = np.where(is_open[:, None], goal, joints)
        return goal, self._is_over_tray(DOWN_M)

    def _is_over_tray(self, height_m: float) -> Mask:
        """Return which objects that were taken are over their tray, below a rise, (n,)."""
        state = self._state
        centre = self._simulator.centre(state.target)[:, :2]
        is_there = is_over(centre - state.memory[DESTINATION])
        is_low = self._simulator.rise(state.target) < height_m
        return state.memory["taken"] & is_there & is_low

    def lowered(self) -> Floats:
        """Return joint angles with each object over its tray, from above down, (H, n, A) [rad]."""
        return self._at_tray(self._lower)

    def left(self) -> Floats:
        """Return joint angles of each gripper on its way from where it let go, (B, n, A) [rad]."""
        return self._at_tray(self._leave)

    def _at_tray(self, tables: Floats) -> Floats:
        """Return the joint angles of each episode's tray and object, (P, n, A), of (T, K, P, A)."""
        state = self._state
        way = self._trays - state.memory[DESTINATION][:, None]
        tray = norm(way, axis=2).argmin(axis=1)
        return tables[tray, state.target].swapaxes(0, 1)


def _between(start: Floats, end: Floats, count: int) -> list[Floats]:
    """Return ``count`` points on each of W legs, end excluded, (count, n, A) each."""
    share = np.linspace(0.0, 1.0, count, endpoint=False)[:, None, None]
    return [interpolate(a, b, share) for a, b in zip(start, end, strict=True)]
