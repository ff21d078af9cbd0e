"""What learning needs of a vector environment; any object with these members will do."""

from typing import Any, Protocol

import numpy as np


class VectorEnvironment(Protocol):
    """A Gymnasium vector environment of images that resets within the step (SAME_STEP).

    ``step`` returns the first observation of the next episode where one ended;
    ``infos["final_obs"][i]`` is then the last observation of the old one, and
    ``infos["final_info"]["is_success"][i]``, where given, tells how it ended.
    """

    num_envs: int

    @property
    def facet_ids(self) -> np.ndarray:
        """(n,) int64: row of the knowledge table of each episode now running."""
        ...

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start episodes; observations (n, H, W, 3) uint8."""
        ...

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Take actions (n, J) int64: observations, rewards, terminated, truncated, infos."""
        ...

    def get_state(self) -> dict[str, np.ndarray]:
        """Return all that is needed to go on to the byte."""
        ...

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Go on from what `get_state` returned."""
        ...

    def close(self) -> None:
        """Free what the environment holds."""
        ...
