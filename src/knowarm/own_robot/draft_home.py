"""Start pose of a drafted robot: near the grasps in joint angles, and turned away from them."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy

from knowarm.arrays import Floats
from knowarm.own_robot.draft_reach import NODES, Layout
from knowarm.world.backend import MujocoSimulator
from knowarm.world.config import EnvConfig
from knowarm.world.scene.scene import Scene, target_places
from knowarm.world.tasks.reward import measure
from knowarm.world.tasks.skills.ik import InverseKinematics

HOME_OFFSET_RAD, HOME_CANDIDATES = 1.3, 600
"""Largest joint distance of the start pose from a grasp's solution, and number of poses tried."""

HOME_ANGLE_DEG = (55.0, 130.0)  # Wanted angle between the start pose and every grasp [deg]
TRAVEL_RAD = 1.75  # Wanted largest travel of a joint from the start pose to a grasp [rad]
STEPS = 25  # Steps that the farthest grasp should take: half an episode, as for the shipped robots
HOMES, DIFFERENT_RAD = 8, 0.4  # Number of start poses, and least difference of some joint
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
    x, y = scene.robot.rectangle_centre_m
    support = scene.robot.support_height_m
    position = np.array([x, y, support]) + scene.grasp_position
    matrix = scene.grasp_matrix.reshape(-1, 9)
    grasps = np.concatenate([branch.joints for branch in layout.branches])
    middle = (grasps.max(axis=0) + grasps.min(axis=0)) / 2
    share = scipy.stats.qmc.Halton(scene.num_joints, scramble=False).random(HOME_CANDIDATES)
    poses = middle + HOME_OFFSET_RAD * (2 * share - 1)
    slack = 0.1 * (scene.joint_upper - scene.joint_lower)
    poses = np.clip(poses, scene.joint_lower + slack, scene.joint_upper - slack)
    simulation = MujocoSimulator(scene, len(poses))
    contacts = simulation.batch.bind("ncon")
    simulation.set_joints(poses)
    touches = contacts.reshape(-1) > 0
    tcp, frame = simulation.tcp_position, simulation.tcp_matrix
    reach = float(np.hypot(x, y))
    angles, distances = np.empty((2, len(position), len(poses)))
    for k in range(len(position)):
        goal = np.tile(position[k], (len(poses), 1)), np.tile(matrix[k], (len(poses), 1))
        distances[k], angles[k] = measure(tcp, frame, *goal, layout.ignore_roll)
    low, high = HOME_ANGLE_DEG
    travel = np.abs(poses[:, None] - grasps).max(axis=(1, 2))
    penalty = (
        100.0 * touches
        + 20.0 * (tcp[:, 2] < support + 0.3 * reach)
        + 5.0 * (tcp[:, 2] > support + 1.2 * reach)
        + 10.0 * (frame[:, 8] > 0.3)
        + 10.0 * (np.hypot(tcp[:, 0], tcp[:, 1]) < 0.35 * reach)
        + 10.0 * (tcp[:, 0] < 0.2 * reach)
        + 0.1 * np.maximum(low - angles.min(axis=0), 0)
        + 0.1 * np.maximum(angles.max(axis=0) - high, 0)
        + 10.0 * np.maximum(travel - TRAVEL_RAD, 0)
        + 10.0 * np.maximum(0.3 - distances.min(axis=0) / reach, 0)
        + 10.0 * np.maximum(distances.max(axis=0) / reach - 1, 0)
        + np.abs(tcp[:, 1]) / reach
    )
    homes: list[Home] = []
    for i in np.argsort(penalty):
        if all(np.abs(poses[i] - other.joints).max() > DIFFERENT_RAD for other in homes):
            text = (
                f"gripper {tcp[i, 2] - support:.2f} m above the support, "
                f"{angles[:, i].min():.0f} to {angles[:, i].max():.0f} degrees and "
                f"{distances[:, i].min():.2f} m from the grasps at the rectangle's middle"
            )
            homes.append(Home(poses[i], float(travel[i]), text))
        if len(homes) == HOMES:
            break
    return sorted(homes, key=lambda home: -_reached(scene, layout, home))


def _reached(scene: Scene, layout: Layout, home: Home) -> float:
    """Return the share of the grasps that are reached from a start pose in time."""
    robot, count = scene.robot, len(scene.targets)
    places = np.array(robot.rectangle_centre_m) + NODES * robot.rectangle_half_size_m
    position = target_places(scene, np.tile(places, (count, 1)))
    position += np.repeat(scene.grasp_position, len(places), axis=0)
    matrix = np.repeat(scene.grasp_matrix.reshape(-1, 9), len(places), axis=0)
    solver = InverseKinematics.within_angle(
        replace(scene, home=home.joints), layout.angle_deg, layout.ignore_roll
    )
    start = np.tile(home.joints, (len(position), 1))
    offset = robot.start_fraction * (scene.joint_upper - scene.joint_lower) / 2
    for joint in robot.start_joints:
        start[:, joint] += offset[joint] * (-1.0) ** np.arange(len(start))
    start = start.clip(scene.joint_lower, scene.joint_upper)
    found = solver.solve(position, matrix, start)
    change = np.abs(found.joints - start).max(axis=1)
    near = change < MOST_TRAVEL * max(home.travel, 1e-6)
    return float((near & found.within(EnvConfig.success_distance_m, layout.angle_deg)).mean())
