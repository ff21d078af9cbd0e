"""Guide of placing: after the grip, a path for arm and object to the tray, and back without it."""

from itertools import product

import numpy as np

from knowarm.arrays import Floats
from knowarm.world.tasks.skills.guides import Sight
from knowarm.world.tasks.skills.ik import REACHED_DEG, REACHED_M
from knowarm.world.tasks.skills.lift.guide import (
    BACK_M,
    GRIP_STEPS,
    ON_APPROACH,
    SETTLE_STEPS,
    UNREACHED,
    UP,
    Leg,
    LiftGuide,
    Surroundings,
    rotation,
)
from knowarm.world.tasks.skills.place.tray import THICK_M
from knowarm.world.tasks.state import Frames

CARRY_M = (0.10, 0.18, 0.28)  # Heights above the support at which the object is carried
RELEASE_M = 0.004  # Height above the tray at which it is let go
TURNS_DEG = (0, 30, -30, 60, -60, 90, -90, 120, -120, 150, -150, 180)
"""Turns of the object about the vertical on the path to the tray."""

RISE = np.array([1.0, 2.0, 3.0]) / 3  # Shares of that height on the path up
LOWER = np.array([0.0, 0.1, 0.3, 0.6, 1.0])  # The same over the tray, from below
AWAY_M = 0.10  # Path upwards after the gripper has left the object


class PlaceGuide(LiftGuide):
    """Takes an object as `LiftGuide`, carries it to the tray, lets it go and leaves.

    It tries turns of the object, those with the shortest path first, each at several heights, and
    takes the first path on which arm and object touch nothing; where there is none, the first.
    """

    def _after_grip(
        self, sight: Sight, path: Floats, surroundings: Surroundings
    ) -> list[Leg]:
        """Return the legs to the tray, and away from it."""
        grasp = path[:, -1]
        surroundings.hold(grasp)
        start = self._follower.pose(grasp)
        joints, (position, matrix), cost = self._over_tray(start, sight, grasp)
        n = len(grasp)
        rise = np.zeros((n, len(RISE), grasp.shape[1]))
        lower = np.zeros((n, len(LOWER), grasp.shape[1]))
        is_free = np.zeros(n, bool)
        is_first = True
        rises: dict[float, Floats] = {}
        for ranked, height in product(np.argsort(cost, axis=0), CARRY_M):
            ids = np.flatnonzero(~is_free)
            if not len(ids):
                break
            if height not in rises:  # The same for every turn
                rises[height] = self._vertical(*start, grasp, height * RISE)
            turn = (ranked[ids], ids)
            up = rises[height][ids]
            down = self._vertical(
                position[turn], matrix[turn], joints[turn], height * LOWER
            )[:, ::-1]
            carry = np.concatenate(
                [up, self._path_through(up[:, -1], down[:, :-1])], axis=1
            )
            is_good = cost[turn] < UNREACHED
            is_good &= surroundings.are_free(ids, carry, 0.0)
            # Where no path turns out to be free, the first one stays.
            is_taken = is_good | is_first
            rise[ids[is_taken]] = up[is_taken]
            lower[ids[is_taken]] = down[is_taken]
            is_free[ids] = is_good
            is_first = False
        self.is_free &= is_free
        return self._legs(rise, lower)

    def _over_tray(
        self, start: Frames, sight: Sight, grasp: Floats
    ) -> tuple[Floats, Frames, Floats]:
        """Solve for the gripper's pose where it lets go of the object, for each of T turns.

        Returns:
            Joint angles (T, n, A), positions (T, n, 3) and rotations (T, n, 9) of the gripper, and
            costs: steps to there, or `UNREACHED`, (T, n).
        """
        position, matrix = start
        # The gripper relative to the object, which it keeps while the object is held
        offset = position.copy()
        offset[:, :2] -= sight.places[:, 0]
        assert sight.destination is not None
        above = np.full(len(grasp), THICK_M + RELEASE_M)
        tray = np.column_stack([sight.destination, above])
        poses = []
        for degrees in TURNS_DEG:
            turn = rotation(2, degrees)
            goal = tray + offset @ turn.T
            goal_matrix = (turn @ matrix.reshape(-1, 3, 3)).reshape(-1, 9)
            solution = self._solver.solve(goal, goal_matrix, grasp, attempts=1)
            steps = np.abs(solution.joints - grasp).max(axis=1) / self._largest
            is_reached = solution.within(REACHED_M, REACHED_DEG)
            cost = np.where(is_reached, steps, UNREACHED)
            poses.append((solution.joints, goal, goal_matrix, cost))
        joints, positions, matrices, costs = map(np.stack, zip(*poses, strict=True))
        return joints, (positions, matrices), costs

    def _vertical(
        self, position: Floats, matrix: Floats, joints: Floats, heights: Floats
    ) -> Floats:
        """Solve for heights above a pose (k,), one after the other, (k, W, A)."""
        shifts = np.outer(heights, UP)
        return self._follower.solve_path(position, matrix, joints, shifts)

    def _legs(self, rise: Floats, lower: Floats) -> list[Leg]:
        """Return the legs from rising (n, W, A) to lowering (n, V, A), letting go and leaving."""
        n = len(rise)
        closed = self._closed_m
        released = lower[:, -1]
        careful = np.full(lower.shape[1], ON_APPROACH)
        position, matrix = self._follower.pose(released)
        back = -matrix.reshape(-1, 3, 3)[:, :, 2]
        shifts = [distance * back for distance in reversed(BACK_M)]
        shifts.append(shifts[-1] + AWAY_M * UP)
        leave = self._follower.solve_path(position, matrix, released, np.stack(shifts))
        return [
            self._moving(rise, closed),
            self._moving(self._path_through(rise[:, -1], lower[:, :1]), closed),
            Leg(lower, np.full(n, closed), careful, SETTLE_STEPS),
            self._standing(released, 0.0, GRIP_STEPS),
            self._moving(leave, 0.0),
        ]


class ReturningGuide(PlaceGuide):
    """Places as `PlaceGuide`, then goes back on the same path to where it started."""

    def _after_grip(
        self, sight: Sight, path: Floats, surroundings: Surroundings
    ) -> list[Leg]:
        """Add the leg back."""
        legs = super()._after_grip(sight, path, surroundings)
        # Without the straight approach and the grasp
        path_there = path[:, : -len(BACK_M) - 1]
        beside_tray = legs[-1].points[:, -1]
        path_back = self._path_through(beside_tray, path_there[:, ::-1])
        return [*legs, self._moving(path_back, 0.0)]
