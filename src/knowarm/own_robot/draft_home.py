"""Start pose of a drafted robot: near the grasps in joint angles, and turned away from them."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from knowarm.arrays import Floats
from knowarm.own_robot.draft_reach import NODES, Layout
from knowarm.own_robot.poses import grasps, sample_shares
from knowarm.world.backend import MujocoSimulator
from knowarm.world.config import SUCCESS_DISTANCE_M
from knowarm.world.scene.scene import Scene
from knowarm.world.tasks.reward import measure
from knowarm.world.tasks.skills.ik import InverseKinematics

HOME_OFFSET_RAD = 1.3
"""Largest joint distance of the start pose from a grasp's solution."""

HOME_CANDIDATES = 600
"""Number of poses tried."""

NEAREST_DEG = 55.0
FARTHEST_DEG = 130.0
"""Least and greatest wanted angle between the start pose and a grasp."""

TRAVEL_RAD = 1.75  # Wanted largest travel of a joint from the start pose to a grasp
STEPS = 25
"""Steps that the farthest grasp should take: half an episode, as for the shipped robots."""

HOMES = 8  # Number of start poses
DIFFERENT_RAD = 0.4  # Least difference of some joint between two of them
MOST_TRAVEL = 1.4
"""Largest change of a joint to a grasp, relative to the travel of the start pose, which takes half
an episode; beyond it inverse kinematics has found another branch."""


class Home(NamedTuple):
    """A start pose."""

    joints: Floats  # (J,) [rad]
    travel: float  # Largest travel of a joint to a grasp [rad or m]
    text: str  # Its description


def find_homes(scene: Scene, layout: Layout) -> list[Home]:
    """Find start poses above the support and turned away from every grasp, yet near in joints.

    The best ones, differing in some joint, are returned in the order of the share of the grasps
    that inverse kinematics reaches from them in time, as the checks of a description do.
    """
    solutions = np.concatenate([branch.joints for branch in layout.branches])
    middle = (solutions.max(axis=0) + solutions.min(axis=0)) / 2
    signed = 2 * sample_shares(scene, HOME_CANDIDATES) - 1
    # Least distance to the joints' limits
    slack = 0.1 * (scene.joint_upper - scene.joint_lower)
    poses = middle + HOME_OFFSET_RAD * signed
    poses = poses.clip(scene.joint_lower + slack, scene.joint_upper - slack)
    simulator = MujocoSimulator(scene, len(poses))
    contacts = simulator.batch.bind("ncon").reshape(-1)
    simulator.set_joints(poses)
    frame = simulator.tcp_matrix
    position = simulator.tcp_position
    x, y, z = position.T
    height = z - scene.robot.support_height_m
    reach = np.hypot(*scene.robot.rectangle_centre_m)
    # Distance and angle to the grasp of each target at the rectangle's middle, (K, n) each
    errors = []
    middles = np.zeros((len(poses), 2))
    for grasp in zip(*grasps(scene, middles), strict=True):
        error = measure(position, frame, *grasp, layout.ignore_roll)
        errors.append(error)
    distances, angles = np.stack(errors, axis=1)
    nearest_m = distances.min(axis=0)
    nearest_deg = angles.min(axis=0)
    farthest_deg = angles.max(axis=0)
    travel = np.abs(poses[:, None] - solutions).max(axis=(1, 2))
    nearest_share = nearest_m / reach
    farthest_share = distances.max(axis=0) / reach
    penalty = (
        100.0 * (contacts > 0)
        + 20.0 * (height < 0.3 * reach)
        + 5.0 * (height > 1.2 * reach)
        + 10.0 * (frame[:, 8] > 0.3)  # The gripper points upwards
        + 10.0 * (np.hypot(x, y) < 0.35 * reach)  # It is above the base,
        + 10.0 * (x < 0.2 * reach)  # or behind it
        # Turned away from the grasps, but near them in joints and space
        + 0.1 * np.maximum(NEAREST_DEG - nearest_deg, 0)
        + 0.1 * np.maximum(farthest_deg - FARTHEST_DEG, 0)
        + 10.0 * np.maximum(travel - TRAVEL_RAD, 0)
        + 10.0 * np.maximum(0.3 - nearest_share, 0)
        + 10.0 * np.maximum(farthest_share - 1, 0)
        + np.abs(y) / reach  # Straight ahead is best
    )
    homes: list[Home] = []
    for i in np.argsort(penalty):
        if len(homes) == HOMES:
            break
        differences = [np.abs(home.joints - poses[i]).max() for home in homes]
        if min(differences, default=np.inf) <= DIFFERENT_RAD:
            continue
        text = (
            f"gripper {height[i]:.2f} m above the support, "
            f"{nearest_deg[i]:.0f} to {farthest_deg[i]:.0f} degrees and "
            f"{nearest_m[i]:.2f} m from the grasps at the rectangle's middle"
        )
        homes.append(Home(poses[i], float(travel[i]), text))
    return sorted(homes, key=lambda home: -_reached(scene, layout, home))


def _reached(scene: Scene, layout: Layout, home: Home) -> float:
    """Return the share of the grasps that are reached from a start pose in time."""
    position, matrix = grasps(scene, NODES)
    position = position.reshape(-1, 3)
    matrix = matrix.reshape(-1, 9)
    start = np.tile(home.joints, (len(position), 1))
    varied = list(scene.robot.start_joints)
    ranges = scene.joint_upper - scene.joint_lower
    offset = scene.robot.start_fraction * (ranges[varied] / 2)
    # Alternate between both ends of the start distribution.
    start[0::2, varied] += offset
    start[1::2, varied] -= offset
    start = start.clip(scene.joint_lower, scene.joint_upper)
    solver = InverseKinematics.within_angle(
        replace(scene, home=home.joints), layout.angle_deg, layout.ignore_roll
    )
    solution = solver.solve(position, matrix, start)
    change = np.abs(solution.joints - start).max(axis=1)
    is_in_time = change < MOST_TRAVEL * max(home.travel, 1e-6)
    is_reached = solution.within(SUCCESS_DISTANCE_M, layout.angle_deg)
    return float((is_in_time & is_reached).mean())
