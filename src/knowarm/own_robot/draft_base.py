"""Base of a drafted robot: turned and shifted so that the arm stands at the origin and faces x."""

from typing import Any

import numpy as np

from knowarm.errors import UserError
from knowarm.own_robot.draft_reach import samples
from knowarm.own_robot.pixels import robot_parts
from knowarm.world.backend import MujocoSimulator
from knowarm.world.scene.compose import ROBOT_PREFIX
from knowarm.world.scene.scene import Scene

NEAR_M = 0.1  # An arm whose first joint is nearer to the origin stays where it is
DIRECTIONS_DEG = np.array([0.0, 90.0, -90.0, 180.0])  # In which an arm may face, from x
CONE_DEG, AHEAD_SHARE = 40.0, 0.5
"""Half-width of a direction, and the least share of the reachable places there, relative to the
direction with most of them, with which an arm faces x."""

FLOATING_M = 0.05  # A robot whose lowest part is higher above the floor floats
REACH_M = (0.08, 10.0)  # Least and greatest distance of the gripper from the first joint of an arm


def place_base(scene: Scene, free: bool) -> dict[str, Any]:
    """Return ``base_position_m`` and ``base_yaw_deg``, if they differ from the file's.

    The scene has the base at the file's origin. A robot whose base is ``free`` stands on the floor.

    Raises:
        UserError: the size of the robot is that of no arm.
    """
    model = scene.model
    joints = samples(scene, 1000)
    simulation = MujocoSimulator(scene, len(joints))
    simulation.set_joints(joints)
    data = scene.at(scene.home)
    first = data.joint(ROBOT_PREFIX + scene.joint_names[0]).xanchor.copy()
    ahead = simulation.tcp_position - first
    reach = float(np.percentile(np.linalg.norm(ahead, axis=1), 95))
    if not REACH_M[0] < reach < REACH_M[1]:
        raise UserError(
            f"Robot {scene.robot.name!r}: the TCP reaches {reach:.3g} m from joint "
            f"{scene.joint_names[0]!r}, which no arm does. A file in centimetres or millimetres "
            "must be scaled to metres; that of a gripper alone holds no arm."
        )
    azimuth = np.degrees(np.arctan2(ahead[:, 1], ahead[:, 0]))
    away = np.abs((azimuth[:, None] - DIRECTIONS_DEG + 180) % 360 - 180)
    counts = (away < CONE_DEG).sum(axis=0)
    best = 0 if counts[0] > AHEAD_SHARE * counts.max() else int(counts.argmax())
    yaw_deg = -float(DIRECTIONS_DEG[best])
    shift = -first[:2] if np.linalg.norm(first[:2]) > NEAR_M else np.zeros(2)
    sine, cosine = np.sin(np.radians(yaw_deg)), np.cos(np.radians(yaw_deg))
    x, y = np.array([[cosine, -sine], [sine, cosine]]) @ shift
    low = (data.geom_xpos[:, 2] - model.geom_rbound)[robot_parts(scene)].min(initial=np.inf)
    z = -float(low) if free and FLOATING_M < low < np.inf else 0.0
    found: dict[str, Any] = {}
    if yaw_deg:
        found["base_yaw_deg"] = yaw_deg
    if yaw_deg or shift.any() or z:
        found["base_position_m"] = [round(float(each), 4) for each in (x, y, z)]
    return found


def lowest_fixed_m(scene: Scene) -> float:
    """Return the least height of the parts of a robot that no joint moves, at most; inf if none."""
    model, data = scene.model, scene.at(scene.home)
    fixed = robot_parts(scene) & (model.body_weldid[model.geom_bodyid] == 0)
    return float((data.geom_xpos[:, 2] - model.geom_rbound)[fixed].min(initial=np.inf))
