"""Messages between A3C's trainer and its workers, and the statistics of their updates."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from knowarm.learn.checkpoint import Arrays
from knowarm.learn.config import A3CConfig
from knowarm.learn.environment import TorchVectorEnv
from knowarm.learn.episode_statistics import FinishedEpisodes
from knowarm.learn.evaluation import Metrics
from knowarm.policy import PolicySpec

MakeEnv = Callable[[int, int], TorchVectorEnv]
"""Creates an environment on the CPU from num_envs and num_threads; picklable."""


@dataclass(frozen=True, kw_only=True)
class A3CWorkerArgs:
    """Arguments of a worker process besides the shared state."""

    index: int
    seed: int
    """Of the run."""
    restarts: int
    """Number of former processes of this worker."""
    config: A3CConfig
    policy: PolicySpec
    make_env: MakeEnv
    evaluate_every: int | None
    failure_folder: Path | None
    state: Arrays | None
    """State of the collector to continue from; None starts new episodes."""


@dataclass(frozen=True, kw_only=True)
class TrainUntil:
    """To a worker: continue until the steps of all workers reach ``total_steps``; 0 pauses it."""

    total_steps: int


@dataclass(frozen=True, kw_only=True)
class SendState:
    """To a worker: send a `WorkerState`."""

    number: int
    """Of the request; the answer repeats it."""
    with_shared: bool
    """Include copies of the shared parameters and statistics."""
    then_exit: bool
    """Exit afterwards."""


@dataclass(frozen=True, kw_only=True)
class UpdateReport:
    """From a worker: one rollout and its update."""

    steps: int
    """Environment steps of the rollout."""
    staleness: int
    """Updates by other workers since this worker read the parameters."""
    policy_loss: float
    value_loss: float
    entropy: float
    grad_norm: float
    threshold_factor: float
    """Factor of the success thresholds from now on."""
    episodes: FinishedEpisodes


@dataclass(frozen=True, kw_only=True)
class EvaluationRequest:
    """From a worker: the parameters when interim evaluation ``number`` was due."""

    number: int
    step: int
    values: np.ndarray


@dataclass(frozen=True, kw_only=True)
class WorkerState:
    """From a worker: its state between two updates."""

    number: int
    """Of the request."""
    collector: Arrays
    steps: int
    updates: int
    values: np.ndarray | None = None
    mean_square: np.ndarray | None = None


@dataclass(frozen=True, kw_only=True)
class TotalReached:
    """From a worker: the steps of all workers have reached the total."""


@dataclass(frozen=True, kw_only=True)
class WorkerRestarted:
    """From the worker pool: a worker died and was restarted."""


_MEANS = ("policy_loss", "value_loss", "entropy", "grad_norm", "threshold_factor")
"""Fields of a report whose means over the updates are metrics."""


@dataclass
class UpdateStatistics:
    """Sums over the updates since the last row of metrics; plain numbers for checkpoints."""

    updates: int = 0
    steps: int = 0
    stale: int = 0
    staleness: int = 0
    policy_loss: float = 0.0
    value_loss: float = 0.0
    entropy: float = 0.0
    grad_norm: float = 0.0
    threshold_factor: float = 0.0
    episodes: int = 0
    episode_return: float = 0.0
    episode_length: int = 0
    successes: int = 0

    def add(self, report: UpdateReport) -> None:
        """Add one update."""
        self.updates += 1
        self.steps += report.steps
        self.stale += report.staleness > 0
        self.staleness += report.staleness
        for name in _MEANS:
            setattr(self, name, getattr(self, name) + getattr(report, name))
        self.episodes += len(report.episodes.length)
        self.episode_return += float(report.episodes.episode_return.sum())
        self.episode_length += int(report.episodes.length.sum())
        self.successes += int(report.episodes.success.sum())

    def metrics(self) -> Metrics:
        """Return means over updates and episodes.

        ``stale_share`` is the fraction of gradients computed from parameters that another worker
        had changed meanwhile, ``staleness_mean`` the mean number of such changes.
        """
        row: Metrics = {"episodes": self.episodes}
        if self.episodes:
            row["return_mean"] = self.episode_return / self.episodes
            row["length_mean"] = self.episode_length / self.episodes
            row["success"] = self.successes / self.episodes
        for name in _MEANS:
            row[name] = getattr(self, name) / self.updates
        row["updates"] = self.updates
        row["stale_share"] = self.stale / self.updates
        row["staleness_mean"] = self.staleness / self.updates
        return row

    def to_dict(self) -> dict[str, Any]:
        """Return the sums as JSON values; ``UpdateStatistics(**values)`` restores them."""
        return asdict(self)
