"""Lifting of a drafted robot: the area, step and direction of objects with which the oracle lifts.

An area is kept by what the oracle does in it: whether two fingers lift an object depends on their
contacts, which inverse kinematics does not see.
"""

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from knowarm.errors import UserError
from knowarm.own_robot.object_check import MIN_ORACLE, oracle_success
from knowarm.world.config import EnvConfig
from knowarm.world.robots.robot import Robot
from knowarm.world.tasks.task import Task

SHARE = (0.25, 0.75)  # Size of the area relative to the rectangle: that of the shipped robots
STEP_M = 0.018
"""Way of the gripper by the largest step of the first joint. A gripper of larger steps stops beside
its grasp; one of smaller steps is slow, and objects turn in its grip."""

TRIALS: tuple[dict[str, float], ...] = (
    {},
    {"target_yaw_deg": 180.0},
    {"target_yaw_deg": -135.0},
    {"target_yaw_deg": 135.0},
)
"""Directions of the objects that are tried, first those of the rectangle."""

ENOUGH = MIN_ORACLE + 0.1  # Success of the oracle from which no other direction is tried


def find_lift_area(
    robot: Robot, describe: Callable[..., str], task: type[Task]
) -> tuple[dict[str, Any], str]:
    """Find the area in which the oracle of a task that moves fingers succeeds most often.

    ``describe`` returns the description as TOML for a file, with fields that are given. Return the
    fields of the area, empty if nothing can be lifted, and what was found.
    """
    radius = float(np.linalg.norm(robot.rectangle_centre_m))
    area = {
        "centre_m": list(robot.rectangle_centre_m),
        "half_size_m": np.round(np.multiply(SHARE, robot.rectangle_half_size_m), 3).tolist(),
        "mpi_rad": round(min(robot.mpi_rad, STEP_M / radius), 3),
    }
    best: tuple[float, dict[str, Any]] = (0.0, {})
    with TemporaryDirectory() as folder:
        for i, turned in enumerate(TRIALS):
            file = Path(folder) / f"lift{i}.toml"
            tried = area | turned
            file.write_text(describe(file, areas={task.area: tried}), "utf-8")
            try:
                success = oracle_success(EnvConfig(robot=str(file), task=task()))
            except UserError as error:
                return {}, f"not possible: {error}"
            best = max(best, (success, tried), key=lambda each: each[0])
            if best[0] >= ENOUGH:
                break
    return best[1], f"the oracle lifts in {100 * best[0]:.0f} % of the episodes in its area"
