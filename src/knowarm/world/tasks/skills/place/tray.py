"""Tray: where it stands, and how large it is."""

from knowarm.errors import UserError
from knowarm.world.robots.robot import Robot

HALF_M = 0.065  # Half of its side
THICK_M = 0.005


def centre_m(robot: Robot) -> tuple[float, float]:
    """Return x and y of the tray's centre [m].

    Raises:
        UserError: the robot has none.
    """
    if robot.tray_m is None:
        raise UserError(
            f"Robot {robot.name!r} has no tray. Set tray_m = [x, y] in its TOML file, beside the "
            "rectangle and within reach."
        )
    return robot.tray_m
