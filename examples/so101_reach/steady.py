"""SO101ReachCube: bring the tool point within 2 cm of a point 2 cm above a cube, and stand still.

A re-implementation, in another simulator, of a task of Squint (Almuzairee et al. 2026), with the
third-person camera of its code in place of the wrist camera of its curves.

    git clone --depth 1 https://github.com/TheRobotStudio/SO-ARM100
    knowarm train bm-distil --env.task steady:Steady --config run.toml
    knowarm evaluate runs/so101-steady-bm-distil/0 --tasks steady:Steady --distance-m 0.02 \\
        --angle-deg 179
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from knowarm.world.tasks.skills.skill import Skill
from knowarm.world.tasks.state import EpisodeState

STEP_S = 0.1
"""Duration of a step [s]."""


@dataclass(frozen=True, kw_only=True)
class Steady(Skill):
    """Reach the goal and stand still there."""

    kind: Literal["steady"] = "steady"
    """Tag of this skill in JSON and in the names of experiments."""

    joints: int = 5
    """Number of the arm's joints."""
    speed_rad_s: float = 0.15
    """Largest mean speed of a joint in a step of standing still [rad/s]."""

    def memory(self, num_envs: int) -> dict[str, NDArray[Any]]:
        """Remember the joint angles, and how far they moved in the step."""
        return {
            "angles": np.zeros((num_envs, self.joints)),
            "moved": np.full(num_envs, np.inf),
        }

    def remember(self, state: EpisodeState) -> Mapping[str, NDArray[Any]]:
        """Measure the step; the first of an episode has no start, and is no standing still."""
        angles = state.simulator.joint_positions.copy()
        moved = np.abs(angles - state.memory["angles"]).max(axis=1)
        return {"angles": angles, "moved": np.where(state.steps > 1, moved, np.inf)}

    def success(self, state: EpisodeState) -> NDArray[np.bool_]:
        """Return which grippers are at the goal and stand still, (n,) bool."""
        still = state.memory["moved"] <= self.speed_rad_s * STEP_S
        return np.asarray(super().success(state) & still)
