"""What A3C's trainer and its workers share: messages, and the shared parameters."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from knowarm.learn.algorithms import A3CConfig
from knowarm.learn.checkpoint import Arrays
from knowarm.learn.environment import TorchVectorEnv
from knowarm.learn.evaluation import Metrics
from knowarm.learn.losses import Terms
from knowarm.learn.parallel.shared_tensors import SharedTensors, TensorSpecs
from knowarm.learn.rollout import FinishedEpisodes
from knowarm.policy import MakePolicy

MakeEnv = Callable[[int, int], TorchVectorEnv]
"""Creates an environment on the CPU from num_envs and num_threads; picklable."""


@dataclass(frozen=True, kw_only=True)
class A3CWorkerArgs:
    """Arguments of a worker process besides the shared state."""

    index: int
    seed: int  # Of the run
    restarts: int  # Number of former processes of this worker
    config: A3CConfig
    total_steps: int  # Environment steps of all workers after which training ends
    make_policy: MakePolicy
    make_env: MakeEnv
    evaluate_every: int | None
    failure_folder: Path | None
    # State of the collector to continue from; None starts new episodes
    state: Arrays | None
    # Of the curriculum so far, for a worker without a state
    threshold_factor: float | None


class StateRequest(NamedTuple):
    """To a worker: send a `WorkerState`, and then exit if ``is_last``."""

    is_last: bool


class WorkerState(NamedTuple):
    """From a worker: its state between two updates."""

    is_last: bool  # As in the request
    collector: Arrays
    steps: int
    vectors: Arrays  # Of worker 0: `copy_vectors` at the same moment


class EvaluationRequest(NamedTuple):
    """The parameters when an interim evaluation was due."""

    step: int
    values: np.ndarray


class UpdateReport(NamedTuple):
    """From a worker: one rollout and its update."""

    sums: Metrics  # Quantities that are summed over updates; see `mean_metrics`
    # If an interim evaluation is due after this update
    evaluation: EvaluationRequest | None


LOSS_METRICS = ("policy_loss", "value_loss", "entropy")


def sums_of(episodes: FinishedEpisodes, loss: Terms) -> Metrics:
    """Return the sums over finished episodes, and the loss, that `mean_metrics` reads."""
    sums = {
        "episodes": len(episodes.length),
        "episode_return": float(episodes.episode_return.sum()),
        "episode_length": int(episodes.length.sum()),
        "successes": int(episodes.success.sum()),
    }
    return sums | {name: float(loss[name].detach()) for name in LOSS_METRICS}


def mean_metrics(sums: Mapping[str, float]) -> Metrics:
    """Return means over updates and finished episodes from the sums of `UpdateReport`."""
    episodes = sums["episodes"]
    updates = sums["updates"]
    row: Metrics = {"episodes": episodes}
    if episodes:
        row["return_mean"] = sums["episode_return"] / episodes
        row["length_mean"] = sums["episode_length"] / episodes
        row["success"] = sums["successes"] / episodes
    for name in (*LOSS_METRICS, "grad_norm", "threshold_factor"):
        row[name] = sums[name] / updates
    row["updates"] = updates
    return row


def copy_vectors(shared: SharedTensors) -> Arrays:
    """Copy the shared parameters and their running mean of squared gradients."""
    return {name: shared.copy(name) for name in ("values", "mean_square")}


def shared_state_specs(parameters: int, workers: int) -> TensorSpecs:
    """Return the tensors that all workers read and write, without locks.

    Each worker writes only its own counters, so no count is lost, and a worker that dies holds
    nothing that others wait for. With P parameters and W workers: ``values`` (P,) of the policy;
    ``mean_square`` (P,), RMSprop's running mean of squared gradients; ``steps`` (W,) of each
    worker; ``evaluated`` (1,), number of the last interim evaluation that a worker requested;
    ``paused`` (1,), whether the workers wait for the evaluator.
    """
    return {
        "values": ((parameters,), torch.float32),
        "mean_square": ((parameters,), torch.float32),
        "steps": ((workers,), torch.int64),
        "evaluated": ((1,), torch.int64),
        "paused": ((1,), torch.bool),
    }
