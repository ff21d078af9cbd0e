"""Records of many workers go in; one row of metrics an interval comes out."""

from dataclasses import asdict, dataclass
from typing import Any

from knowarm.learn.a3c.messages import Record
from knowarm.learn.trainer import Metrics


@dataclass
class Window:
    """Sums over the updates since the last row; plain numbers, so that they can be saved."""

    updates: int = 0
    steps: int = 0
    stale: int = 0
    staleness: int = 0
    policy_loss: float = 0.0
    value_loss: float = 0.0
    entropy: float = 0.0
    grad_norm: float = 0.0
    episodes: int = 0
    episode_return: float = 0.0
    episode_length: int = 0
    successes: int = 0

    def add(self, record: Record) -> None:
        """Take one worker's update."""
        self.updates += 1
        self.steps += record.steps
        self.stale += record.staleness > 0
        self.staleness += record.staleness
        for name in ("policy_loss", "value_loss", "entropy", "grad_norm"):
            setattr(self, name, getattr(self, name) + getattr(record, name))
        self.episodes += len(record.episodes.length)
        self.episode_return += float(record.episodes.episode_return.sum())
        self.episode_length += int(record.episodes.length.sum())
        self.successes += int(record.episodes.success.sum())

    def row(self) -> Metrics:
        """Return means over the updates and episodes of the window.

        ``stale_share`` is the share of gradients that were computed from parameters another
        worker had meanwhile changed, ``staleness_mean`` by how many updates on average.
        """
        row: Metrics = {"episodes": self.episodes}
        if self.episodes:
            row["return_mean"] = self.episode_return / self.episodes
            row["length_mean"] = self.episode_length / self.episodes
            row["success"] = self.successes / self.episodes
        for name in ("policy_loss", "value_loss", "entropy", "grad_norm"):
            row[name] = getattr(self, name) / self.updates
        row["updates"] = self.updates
        row["stale_share"] = self.stale / self.updates
        row["staleness_mean"] = self.staleness / self.updates
        return row

    def facts(self) -> dict[str, Any]:
        """Return the sums as JSON values; ``Window(**facts)`` goes on from them."""
        return asdict(self)
