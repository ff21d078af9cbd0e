"""SO101ReachCube: bring the tool point within 2 cm of a point 2 cm above a cube, and stand still.

A re-implementation, in another simulator, of a task of Squint (Almuzairee et al. 2025), with the
third-person camera of its code in place of the wrist camera of its curves.

    git clone --depth 1 https://github.com/TheRobotStudio/SO-ARM100
    knowarm train irb120-bm-distil --name so101 --env.task steady:Steady --config run.toml
    knowarm evaluate runs/so101/0 --tasks steady:Steady --distance-m 0.02 --angle-deg 179
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from knowarm.world.tasks.state import EpisodeState
from knowarm.world.tasks.task import Task

SPEED = 0.15
"""Largest speed of a joint that stands still [rad/s]."""


@dataclass(frozen=True, kw_only=True)
class Steady(Task):
    """Reach the goal and stand still there."""

    kind: Literal["steady"] = "steady"
    """Tag of this task in JSON and in the names of experiments."""
    targets = ("cube.toml",)

    servo_rad_s: float = 44.0
    """Natural frequency of the servos [rad/s], from which the speed of a joint follows."""

    def success(self, state: EpisodeState) -> NDArray[np.bool_]:
        """Return which grippers are at the goal and stand still, (n,) bool."""
        # A critically damped servo that is e from its target .1 s after a step moves at about
        # e * w^2 t / (1 + w t).
        w, t = self.servo_rad_s, 0.1
        lag = np.abs(state.joint_targets - state.simulator.joint_positions).max(1)
        return np.asarray(super().success(state) & (lag * w * w * t / (1 + w * t) <= SPEED))
