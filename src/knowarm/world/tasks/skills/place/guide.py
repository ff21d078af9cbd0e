"""Guide of placing: after the grip, a path for arm and object to the tray, and back without it."""

import numpy as np

from knowarm.arrays import Floats
from knowarm.world.tasks.skills.guides import Sight
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
    tries_at_once,
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
        position, matrix = self._over_tray(start, sight)
        joints, cost = self._solve_near(position, matrix, grasp)
        n = len(grasp)
        rises = self._follower.solve_path(
            *start, grasp, _upwards(np.outer(RISE, CARRY_M))
        )
        rise = rises[0].copy()
        lower = np.zeros((n, len(LOWER), grasp.shape[1]))
        is_free = np.zeros(n, bool)
        # Each turn is tried at several heights.
        order = np.argsort(cost, axis=0, kind="stable")
        turns = np.repeat(order, len(CARRY_M), axis=0)
        is_reached = np.take_along_axis(cost, turns, axis=0) < UNREACHED
        heights = np.tile(CARRY_M, len(cost))
        for tries, columns in tries_at_once(is_reached, is_free, np.arange(n)):
            turn = (turns[tries][:, columns], columns)
            solved = self._follower.solve_path(
                position[turn],
                matrix[turn],
                joints[turn],
                _upwards(np.outer(LOWER, heights[tries])),
            )
            for number, lowering in enumerate(solved, tries.start):
                is_open = ~is_free[columns]
                ids = columns[is_open]
                if not len(ids):
                    break
                up = rises[number % len(CARRY_M), ids]
                down = lowering[is_open, ::-1]
                carry = np.concatenate(
                    [up, self._path_through(up[:, -1], down[:, :-1])], axis=1
                )
                is_good = surroundings.are_free(
                    ids, carry, 0.0, is_reached[number, ids]
                )
                # Where no path turns out to be free, the first one stays.
                is_taken = is_good | (number == 0)
                rise[ids[is_taken]] = up[is_taken]
                lower[ids[is_taken]] = down[is_taken]
                is_free[ids] = is_good
        self.is_free &= is_free
        return self._legs(rise, lower)

    def _over_tray(self, start: Frames, sight: Sight) -> Frames:
        """Return the poses at which the gripper lets go of the object, one for each turn."""
        position, matrix = start
        # The gripper relative to the object, which it keeps while the object is held
        offset = position.copy()
        offset[:, :2] -= sight.places[:, 0]
        assert sight.destination is not None
        above = np.full(len(position), THICK_M + RELEASE_M)
        tray = np.column_stack([sight.destination, above])
        turns = np.stack([rotation(2, degrees) for degrees in TURNS_DEG])
        matrices = turns[:, None] @ matrix.reshape(-1, 3, 3)
        goal = tray + offset @ turns.transpose(0, 2, 1)
        return goal, matrices.reshape(len(turns), -1, 9)

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


def _upwards(heights: Floats) -> Floats:
    """Return W heights above each of H poses as shifts, (W, H, 1, 3) [m]."""
    return heights[..., None, None] * UP
