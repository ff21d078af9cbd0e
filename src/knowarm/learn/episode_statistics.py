"""Episode statistics: returns, lengths and successes of the episodes that ended."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor


@dataclass(frozen=True)
class FinishedEpisodes:
    """Episodes that ended, in order of time and environment; arrays (N,)."""

    episode_return: np.ndarray
    """Undiscounted sum of rewards, float64."""
    length: np.ndarray
    """Number of steps, int64."""
    success: np.ndarray
    """Whether the episode ended in success, bool."""

    def summary(self) -> dict[str, float]:
        """Return the number of episodes and, if there are any, their means."""
        count = len(self.length)
        if count == 0:
            return {"episodes": 0}
        return {
            "episodes": count,
            "return_mean": float(self.episode_return.mean()),
            "length_mean": float(self.length.mean()),
            "success": float(self.success.mean()),
        }


class EpisodeStatistics:
    """Accumulates rewards and steps of the running episodes of n environments."""

    def __init__(self, num_envs: int, device: torch.device) -> None:
        self._return = torch.zeros(num_envs, dtype=torch.float64, device=device)
        self._length = torch.zeros(num_envs, dtype=torch.int64, device=device)
        self._steps: list[tuple[Tensor, Tensor, Tensor, Tensor]] = []

    def add(self, reward: Tensor, done: Tensor, success: Tensor) -> None:
        """Add one step's results, (n,) each; ``success`` is read where ``done``."""
        self._return = self._return + reward
        self._length = self._length + 1
        self._steps.append((done, self._return, self._length, success & done))
        self._return = torch.where(done, 0, self._return)
        self._length = torch.where(done, 0, self._length)

    def take(self) -> FinishedEpisodes:
        """Return the episodes that ended since the last call."""
        if not self._steps:
            return FinishedEpisodes(np.zeros(0), np.zeros(0, np.int64), np.zeros(0, bool))
        done, returns, lengths, success = (
            torch.stack(column).cpu().numpy() for column in zip(*self._steps, strict=True)
        )
        self._steps = []
        return FinishedEpisodes(returns[done], lengths[done], success[done].astype(bool))

    def get_state(self) -> dict[str, np.ndarray]:
        """Return the sums of the running episodes; requires that `take` was called."""
        assert not self._steps
        return {
            "return": self._return.cpu().numpy().copy(),
            "length": self._length.cpu().numpy().copy(),
        }

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Continue from the result of `get_state`."""
        self._return.copy_(torch.from_numpy(state["return"]))
        self._length.copy_(torch.from_numpy(state["length"]))
