"""Messages between A3C's trainer and its workers."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from knowarm.learn.algorithms import A3CConfig
from knowarm.learn.checkpoint import Arrays
from knowarm.learn.environment import TorchVectorEnv
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
    total_steps: int
    """Environment steps of all workers after which training ends."""
    policy: PolicySpec
    make_env: MakeEnv
    evaluate_every: int | None
    failure_folder: Path | None
    state: Arrays | None
    """State of the collector to continue from; None starts new episodes."""


class StateRequest(NamedTuple):
    """To a worker: send a `WorkerState`, and then exit if ``is_last``."""

    is_last: bool


class WorkerState(NamedTuple):
    """From a worker: its state between two updates; worker 0 adds copies of shared vectors."""

    is_last: bool
    """As in the request."""
    collector: Arrays
    steps: int
    updates: int
    values: np.ndarray | None = None
    mean_square: np.ndarray | None = None


class EvaluationRequest(NamedTuple):
    """The parameters when interim evaluation ``number`` was due."""

    number: int
    step: int
    values: np.ndarray


class UpdateReport(NamedTuple):
    """From a worker: one rollout and its update."""

    sums: dict[str, float]
    """Quantities that are summed over updates; see `mean_metrics`."""
    evaluation: EvaluationRequest | None
    """If an interim evaluation is due after this update."""


def mean_metrics(sums: Mapping[str, float]) -> Metrics:
    """Return means over updates and finished episodes from the sums of `UpdateReport`."""
    row: Metrics = {"episodes": sums["episodes"]}
    if sums["episodes"]:
        row["return_mean"] = sums["episode_return"] / sums["episodes"]
        row["length_mean"] = sums["episode_length"] / sums["episodes"]
        row["success"] = sums["successes"] / sums["episodes"]
    for name in ("policy_loss", "value_loss", "entropy", "grad_norm", "threshold_factor"):
        row[name] = sums[name] / sums["updates"]
    return row | {"updates": sums["updates"]}
