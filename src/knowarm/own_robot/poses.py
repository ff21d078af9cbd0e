"""What drafts and checks compute with: a robot's file, places, grasps there, and poses."""

from typing import Any

import numpy as np
import scipy
from mujoco import MjSpec

from knowarm.arrays import Floats
from knowarm.world.backend import MujocoSimulator
from knowarm.world.robots.robot import Robot
from knowarm.world.scene.mjcf import read_mjcf
from knowarm.world.scene.scene import Scene, target_places
from knowarm.world.tasks.skills.ik import InverseKinematics

Fields = dict[str, Any]
"""Fields of a robot's description, as they are written to TOML."""

CORNERS = (
    (-1, -1),
    (-1, 1),
    (1, 1),
    (1, -1),
)
"""Corners of a rectangle in order, relative to its centre and half-sizes."""


def robot_file(robot: Robot) -> MjSpec:
    """Read the MJCF file of a description."""
    return read_mjcf(robot.mjcf, f"Robot {robot.name!r}")


def rectangle_places(robot: Robot, signs: Any) -> Floats:
    """Return places in a robot's rectangle [m] by their signs (n, 2), -1 to 1 between its sides."""
    centre = np.array(robot.rectangle_centre_m)
    half = np.array(robot.rectangle_half_size_m)
    return centre + half * signs


def support_places(scene: Scene, signs: Any) -> Floats:
    """Return places in the rectangle on its support, world, (n, 3) [m], by their signs (n, 2)."""
    return target_places(scene, rectangle_places(scene.robot, signs))


def grasps(scene: Scene, signs: Any) -> tuple[Floats, Floats]:
    """Return the grasps of K targets at n places in the rectangle, by their signs (n, 2).

    Positions (K, n, 3) [m] and row-major rotations (K, n, 9), world.
    """
    position = support_places(scene, signs) + scene.grasp_position[:, None]
    matrix = scene.grasp_matrix.reshape(-1, 1, 9)
    return position, np.repeat(matrix, len(signs), axis=1)


def sample_shares(scene: Scene, count: int) -> Floats:
    """Spread shares of the joints' ranges evenly, (count, J) in 0..1: a Halton sequence."""
    sequence = scipy.stats.qmc.Halton(scene.num_joints, scramble=False)
    return sequence.random(count)


def sample_joints(scene: Scene, count: int) -> Floats:
    """Spread joint angles over their ranges, (count, J) [rad]."""
    ranges = scene.joint_upper - scene.joint_lower
    return scene.joint_lower + sample_shares(scene, count) * ranges


def sample_tips(scene: Scene, count: int) -> Floats:
    """Return where the gripper is at joint angles over their ranges, world, (count, 3) [m]."""
    position, _ = InverseKinematics(scene).pose(sample_joints(scene, count))
    return position


def place_targets(scene: Scene, joints: Floats, signs: Any) -> MujocoSimulator:
    """Pose an arm at angles (J,) [rad] and all targets at one place per copy, by signs (n, 2)."""
    count = len(signs)
    simulation = MujocoSimulator(scene, count)
    places = rectangle_places(scene.robot, signs)
    positions = np.repeat(places[:, None], len(scene.targets), axis=1)
    angles = np.tile(joints, (count, 1))
    simulation.reset(np.arange(count), angles, positions)
    return simulation


def rounded(values: Any) -> list[float]:
    """Return numbers as they are written to a description."""
    return [round(float(value), 4) for value in values]
