"""A skill of your own: hold the tool centre point 10 cm above the object for ten steps.

From the folder of this file::

    knowarm train irb120-full-fast --env.task hover:Hover
    knowarm evaluate runs/irb120-hover-full-fast/0 --tasks hover:Hover

Above the object that answers a query::

    knowarm train irb120-choose-answers-distil --env.task hover:Hover
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from knowarm.world.scene.scene import Scene
from knowarm.world.tasks.skills.skill import Skill
from knowarm.world.tasks.state import EpisodeState


@dataclass(frozen=True, kw_only=True)
class Hover(Skill):
    """Hold the gripper above the grasp point, in the orientation of the grasp."""

    kind: Literal["hover"] = "hover"
    """Tag of this skill in JSON and in the names of experiments."""

    height_m: float = 0.10
    """Height above the grasp point [m]."""

    hold_steps: int = 10
    """Consecutive steps within the thresholds that count as success."""

    def goal(
        self,
        scene: Scene,
        objects: NDArray[np.int64],
        position: NDArray[np.float64],
        matrix: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the frame above the grasp frame, (k, 3) [m] and (k, 9)."""
        return position + np.array([0.0, 0.0, self.height_m]), matrix

    def memory(self, num_envs: int) -> dict[str, NDArray[Any]]:
        """Remember for how many steps the gripper has been at the goal."""
        return {"held": np.zeros(num_envs, dtype=np.int64)}

    def remember(self, state: EpisodeState) -> Mapping[str, NDArray[Any]]:
        """Count the step, or start again."""
        at_goal = super().success(state)
        return {"held": np.where(at_goal, state.memory["held"] + 1, 0)}

    def success(self, state: EpisodeState) -> NDArray[np.bool_]:
        """Return which grippers have been held long enough, (n,) bool."""
        return np.asarray(state.memory["held"] >= self.hold_steps)

    def reward(self, state: EpisodeState) -> NDArray[np.float64]:
        """Add 1 for every step at the goal to the paper's reward, (n,)."""
        return super().reward(state) + (state.memory["held"] > 0)

    def infos(self, state: EpisodeState) -> dict[str, NDArray[Any]]:
        """Add the number of steps held."""
        return {"held": state.memory["held"]}

    def columns(
        self, setting: Any, infos: Mapping[str, NDArray[Any]]
    ) -> dict[str, NDArray[Any]]:
        """Store the number of steps held at the end of each episode."""
        return {"held": infos["held"]}
