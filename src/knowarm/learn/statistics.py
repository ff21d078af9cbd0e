"""Rewards and episode ends go in; returns, lengths and successes of whole episodes come out."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class FinishedEpisodes:
    """Episodes that ended, in the order they did; arrays (N,)."""

    episode_return: np.ndarray
    length: np.ndarray
    success: np.ndarray

    def summary(self) -> dict[str, float]:
        """Count and means; means are left out where no episode ended."""
        count = len(self.length)
        if count == 0:
            return {"episodes": 0}
        return {
            "episodes": count,
            "return_mean": float(self.episode_return.mean()),
            "length_mean": float(self.length.mean()),
            "success": float(self.success.mean()),
        }

    @classmethod
    def join(cls, parts: "Sequence[FinishedEpisodes]") -> "FinishedEpisodes":
        """Put several lists of episodes behind each other."""
        empty = cls(np.zeros(0), np.zeros(0, np.int64), np.zeros(0, bool))
        parts = [empty, *parts]
        return cls(
            np.concatenate([p.episode_return for p in parts]),
            np.concatenate([p.length for p in parts]),
            np.concatenate([p.success for p in parts]),
        )


class EpisodeStatistics:
    """Adds up rewards and steps of the running episodes of ``num_envs`` environments."""

    def __init__(self, num_envs: int) -> None:
        self._return = np.zeros(num_envs)
        self._length = np.zeros(num_envs, np.int64)
        self._finished: list[FinishedEpisodes] = []

    def add(
        self,
        rewards: np.ndarray,
        terminated: np.ndarray,
        truncated: np.ndarray,
        infos: dict[str, Any],
    ) -> None:
        """Take one step's results, each (n,)."""
        self._return += rewards
        self._length += 1
        done = np.flatnonzero(terminated | truncated)
        if len(done):
            success = np.asarray(infos.get("final_info", {}).get("is_success", terminated))
            self._finished.append(
                FinishedEpisodes(self._return[done], self._length[done], success[done].astype(bool))
            )
            self._return[done] = 0
            self._length[done] = 0

    def take(self) -> FinishedEpisodes:
        """Return the episodes that ended since the last call, and forget them."""
        finished = FinishedEpisodes.join(self._finished)
        self._finished = []
        return finished

    def get_state(self) -> dict[str, np.ndarray]:
        """Return the running sums; to be called when nothing is waiting to be taken."""
        assert not self._finished
        return {"return": self._return.copy(), "length": self._length.copy()}

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Go on from what `get_state` returned."""
        self._return[:] = state["return"]
        self._length[:] = state["length"]
