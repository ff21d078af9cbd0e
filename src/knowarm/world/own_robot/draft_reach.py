"""Reach of a drafted robot: distance, and the rectangle and yaws that it can grasp at."""

import math
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from knowarm.errors import UserError
from knowarm.world.agents.ik import InverseKinematics
from knowarm.world.backend import MujocoSimulator
from knowarm.world.scene.scene import Scene

CELLS = 7  # Places along each side of the area in which the rectangle is searched
YAWS_DEG = (-135.0, 180.0, 135.0, -90.0, 90.0)
"""Directions of the targets that are tried, by preference [deg]."""

TOLERANCES = ((15.0, False), (15.0, True), (30.0, True), (45.0, True), (60.0, True), (90.0, True))
"""Success angles [deg] and whether the roll is ignored, from the task as it is to the easiest."""

ENOUGH_CELLS = 6  # Least number of places in a rectangle for a task to be proposed
DISTANCE_M = 0.03  # Distance from the grasp point within which a place counts as reached [m]


def _samples(scene: Scene, count: int) -> NDArray[np.float64]:
    """Spread joint angles over their ranges, (count, J)."""
    share = scipy.stats.qmc.Halton(scene.num_joints, scramble=False).random(count)
    return np.asarray(scene.joint_lower + share * (scene.joint_upper - scene.joint_lower))


def reach_m(scene: Scene) -> float:
    """Return the horizontal distance that the gripper reaches at the height of the grasps [m]."""
    joints = _samples(scene, 3000)
    simulation = MujocoSimulator(scene, len(joints))
    simulation.set_joints(joints)
    place = simulation.tcp_position
    low, high = 0.0, max(0.1, float(scene.grasp_position[:, 2].max()) * 1.5)
    near = (place[:, 2] > low) & (place[:, 2] < high)
    if near.sum() < 10:
        raise UserError(
            f"Robot {scene.robot.name!r}: the gripper never comes to a height of {low:.2f} to "
            f"{high:.2f} m, where the targets' grasps are. Give base_position_m, or a table."
        )
    return float(np.percentile(np.hypot(place[near, 0], place[near, 1]), 95))


def places(reach: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return x and y of the places in front of the robot that are tried [m]."""
    return np.linspace(0.35, 0.95, CELLS) * reach, np.linspace(-0.55, 0.55, CELLS) * reach


def reach_table(
    scene: Scene, reach: float
) -> tuple[float, bool, list[float], tuple[int, int, int, int]]:
    """Find the strictest task with a rectangle that the arm can reach, and the targets' yaws.

    Return the success angle [deg], whether the roll is ignored, a yaw per target [deg], and first
    and last cell of the rectangle along x and y.
    """
    x, y = (grid.ravel() for grid in np.meshgrid(*places(reach), indexing="ij"))
    support = scene.robot.support_height_m
    found: dict[tuple[int, float, bool], tuple[Any, Any]] = {}
    for roll in (False, True):
        solver = InverseKinematics(scene, starts=4, ignore_roll=roll)
        for k in range(len(scene.targets)):
            for yaw in YAWS_DEG:
                turn = _turn(yaw)
                position = np.stack([x, y, np.full_like(x, support)], axis=1)
                position = position + turn @ scene.grasp_position[k]
                matrix = np.tile((turn @ scene.grasp_matrix[k]).ravel(), (len(x), 1))
                home = np.tile(scene.home, (len(x), 1))
                solution = solver.solve(position, matrix, home, attempts=1)
                near = (solution.distance < DISTANCE_M) & ~solution.contact
                found[k, yaw, roll] = near, solution.angle
        for angle, free in TOLERANCES:
            if free is not roll:
                continue
            yaws, reached = [], np.ones(len(x), dtype=np.bool_)
            for k in range(len(scene.targets)):
                masks = [
                    near & (a < angle - 2) for near, a in (found[k, w, roll] for w in YAWS_DEG)
                ]
                best = max(range(len(YAWS_DEG)), key=lambda i: int((masks[i] & reached).sum()))
                yaws.append(YAWS_DEG[best])
                reached = reached & masks[best]
            cells = _largest_rectangle(reached.reshape(CELLS, CELLS))
            if cells and (cells[1] - cells[0] + 1) * (cells[3] - cells[2] + 1) >= ENOUGH_CELLS:
                return angle, free, yaws, cells
    raise UserError(
        f"Robot {scene.robot.name!r}: inverse kinematics reaches no rectangle in front of the "
        f"robot (x from {places(reach)[0][0]:.2f} to {places(reach)[0][-1]:.2f} m) with any of the "
        "orientation tolerances tried. Turn the base (base in the MJCF: x forward), name other "
        "targets, or check the joints' ranges and the TCP."
    )


def _turn(yaw_deg: float) -> NDArray[np.float64]:
    cosine, sine = math.cos(math.radians(yaw_deg)), math.sin(math.radians(yaw_deg))
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def _largest_rectangle(mask: NDArray[np.bool_]) -> tuple[int, int, int, int] | None:
    """Return first and last row and first and last column of the largest all-true rectangle."""
    best, most = None, 0
    rows, columns = mask.shape
    for a in range(rows):
        for b in range(a, rows):
            for c in range(columns):
                for d in range(c, columns):
                    size = (b - a + 1) * (d - c + 1)
                    if size > most and mask[a : b + 1, c : d + 1].all():
                        best, most = (a, b, c, d), size
    return best
