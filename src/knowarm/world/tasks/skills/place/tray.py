"""Trays: where they stand, and how large they are."""

from collections.abc import Callable

import numpy as np
from mujoco import MjSpec, mjtGeom

from knowarm.arrays import Floats, Mask
from knowarm.errors import UserError
from knowarm.world.robots.robot import Robot
from knowarm.world.scene.compose import ROBOT_BIT, SUPPORT_BIT

HALF_M = 0.065  # Half of a tray's side
THICK_M = 0.005
DOWN_M = 0.02  # Rise below which a released object has been put down
RGBA = (0.30, 0.36, 0.46, 1.0)


def centres_m(robot: Robot, least: int = 1) -> Floats:
    """Return x and y of the trays' centres, (K, 2) [m].

    Raises:
        UserError: the robot has fewer than the ``least``.
    """
    count = len(robot.trays_m)
    if count < least:
        raise UserError(
            f"Robot {robot.name!r} has {count} trays, and this skill needs {least}. Set trays_m = "
            "[[x, y], ...] in its TOML file, beside the rectangle and within reach."
        )
    return np.array(robot.trays_m)


def is_over(offset: Floats) -> Mask:
    """Return which offsets from a tray's centre (n, 2) [m] are above the tray, (n,)."""
    is_within: Mask = np.abs(offset) < HALF_M
    return np.all(is_within, axis=1)


def add_trays(robot: Robot, centres: Floats) -> Callable[[MjSpec], None]:
    """Return what adds trays, the geoms ``tray_0`` to ``tray_<K - 1>``, to a robot's scene."""

    def furnish(spec: MjSpec) -> None:
        for number, (x, y) in enumerate(centres):
            spec.worldbody.add_geom(
                name=tray_name(number),
                type=mjtGeom.mjGEOM_BOX,
                size=[HALF_M, HALF_M, THICK_M / 2],
                pos=[x, y, robot.support_height_m + THICK_M / 2],
                rgba=RGBA,
                contype=SUPPORT_BIT,
                conaffinity=ROBOT_BIT,
            )

    return furnish


def tray_name(number: int) -> str:
    """Return the name of a tray's geom."""
    return f"tray_{number}"
