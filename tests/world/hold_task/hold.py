"""A skill with fingers and two phases, as one outside the package: lift the object and hold it."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

import knowarm


@dataclass(frozen=True, kw_only=True)
class Hold(knowarm.Lift):
    """Lift the object, and then keep it up; an object that is dropped ends the episode."""

    kind: Literal["hold"] = "hold"
    height_m: float = 0.06
    hold_steps: int = 20
    max_steps = 120

    def memory(self, num_envs):
        """Remember for how many steps it is up, and whether it has ever been."""
        return super().memory(num_envs) | {"lifted": np.zeros(num_envs, dtype=np.bool_)}

    def remember(self, state):
        """Count the step; once it is up, the second phase begins."""
        memory = super().remember(state)
        return memory | {"lifted": state.memory["lifted"] | (memory["held"] > 0)}

    def failure(self, state):
        """Return which objects were lost, or let go after they were lifted, (n,)."""
        dropped = state.memory["lifted"] & ~state.simulator.touched(state.target)
        return super().failure(state) | dropped

    def reward(self, state):
        """Add the share of the second phase that is over to the reward of lifting, (n,)."""
        return super().reward(state) + state.memory["held"] / self.hold_steps

    def infos(self, state):
        """Add the steps held."""
        return super().infos(state) | {"held": state.memory["held"]}
