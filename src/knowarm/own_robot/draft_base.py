"""Base of a drafted robot: turned and shifted so that the arm stands at the origin and faces x."""

import numpy as np
from numpy.linalg import norm
from scipy.spatial.transform import Rotation

from knowarm.arrays import Floats, Integers
from knowarm.errors import UserError
from knowarm.own_robot.draft_chain import extent
from knowarm.own_robot.pixels import robot_parts
from knowarm.own_robot.plausible import stands_on
from knowarm.own_robot.poses import Fields, rounded, sample_tips
from knowarm.world.scene.compose import ROBOT_PREFIX
from knowarm.world.scene.scene import Scene

NEAR_M = 0.1  # An arm whose first joint is nearer to the origin stays where it is
DIRECTIONS_DEG = np.array([0.0, 90.0, -90.0, 180.0])  # In which an arm may face, from x
CONE_DEG = 40.0
"""Half-width of a direction."""

AHEAD_SHARE = 0.5
"""Least share of the reachable places around x, relative to the direction with most of them, with
which an arm faces x."""

FLOATING_M = 0.05  # A robot whose lowest part is higher above the floor floats
LEAST_REACH_M = 0.08  # Of the gripper of an arm from its first joint
GREATEST_REACH_M = 10.0


def place_base(scene: Scene, free: bool) -> Fields:
    """Return ``base_position_m`` and ``base_yaw_deg``, if they differ from the file's.

    The scene has the base at the file's origin. A robot whose base is ``free``, or whose table is
    left out, stands on the floor.

    Raises:
        UserError: the size of the robot is that of no arm.
    """
    first = scene.joint_names[0]
    origin = scene.at(scene.home).joint(ROBOT_PREFIX + first).xanchor.copy()
    ahead = sample_tips(scene, 1000) - origin
    reach = float(np.percentile(norm(ahead, axis=1), 95))
    if not LEAST_REACH_M < reach < GREATEST_REACH_M:
        raise UserError(
            f"Robot {scene.robot.name!r}: the TCP reaches {reach:.3g} m from joint {first!r}, "
            "which no arm does. A file in centimetres or millimetres must be scaled to metres; "
            "that of a gripper alone holds no arm."
        )
    yaw_deg = -_faced_deg(ahead)
    shift = np.zeros(3)
    if norm(origin[:2]) > NEAR_M:
        shift[:2] = -origin[:2]
    low = lowest_m(scene, np.flatnonzero(robot_parts(scene)))
    is_above_floor = FLOATING_M < low < np.inf
    if is_above_floor and (free or stands_on(scene.robot, low)):
        shift[2] = -low
    changed: Fields = {}
    if yaw_deg:
        changed["base_yaw_deg"] = yaw_deg
    if yaw_deg or shift.any():
        turn = Rotation.from_euler("z", yaw_deg, degrees=True)
        changed["base_position_m"] = rounded(turn.apply(shift))
    return changed


def _faced_deg(ahead: Floats) -> float:
    """Return the direction that most places (n, 3) lie in, from x; x if enough lie there."""
    x, y, _ = ahead.T
    azimuth = np.degrees(np.arctan2(y, x))
    turned = azimuth[:, None] - DIRECTIONS_DEG
    away = np.abs((turned + 180) % 360 - 180)
    counts = (away < CONE_DEG).sum(axis=0)
    if counts[0] > AHEAD_SHARE * counts.max():
        return 0.0
    return float(DIRECTIONS_DEG[counts.argmax()])


def lowest_m(scene: Scene, geoms: Integers) -> float:
    """Return the least height of geoms at home, at most; inf if there are none."""
    down = np.array([0.0, 0.0, -1.0])
    return -extent(scene.at(scene.home), geoms, down)
