"""Rewards and episode ends on a device go in; means over whole episodes come out."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor


@dataclass(frozen=True)
class EpisodeSums:
    """Sums over the episodes that ended."""

    episodes: int
    episode_return: float
    length: float
    success: float

    def summary(self) -> dict[str, float]:
        """Count and means, named as `FinishedEpisodes.summary`'s."""
        count = self.episodes
        if count == 0:
            return {"episodes": 0}
        return {
            "episodes": count,
            "return_mean": self.episode_return / count,
            "length_mean": self.length / count,
            "success": self.success / count,
        }


class TensorStatistics:
    """Adds up rewards and steps of the running episodes without waiting for the device.

    Args:
        num_envs: n.
        device: where the numbers are.
    """

    def __init__(self, num_envs: int, device: torch.device) -> None:
        self._return = torch.zeros(num_envs, dtype=torch.float64, device=device)
        self._length = torch.zeros(num_envs, dtype=torch.int64, device=device)
        self._sums = torch.zeros(4, dtype=torch.float64, device=device)

    def add(self, reward: Tensor, done: Tensor, success: Tensor) -> None:
        """Take one step's results, each (n,); ``success`` counts where ``done``."""
        self._return = self._return + reward
        self._length = self._length + 1
        ended = torch.stack(
            [torch.ones_like(self._return), self._return, self._length, success.double()]
        )
        self._sums = self._sums + torch.where(done, ended, 0).sum(1)
        self._return = torch.where(done, 0, self._return)
        self._length = torch.where(done, 0, self._length)

    def take(self) -> EpisodeSums:
        """Return the sums since the last call, and forget them; waits for the device."""
        count, *sums = self._sums.tolist()
        self._sums = torch.zeros_like(self._sums)
        return EpisodeSums(int(count), *sums)

    def get_state(self) -> dict[str, np.ndarray]:
        """Return the running sums; to be called when nothing is waiting to be taken."""
        return {
            "return": self._return.cpu().numpy().copy(),
            "length": self._length.cpu().numpy().copy(),
        }

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Go on from what `get_state` returned."""
        self._return.copy_(torch.from_numpy(state["return"]))
        self._length.copy_(torch.from_numpy(state["length"]))
