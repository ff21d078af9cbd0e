"""What workers, the evaluator and the trainer tell each other; every class is one message."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from knowarm.learn.checkpoint import Arrays
from knowarm.learn.config import A3CConfig
from knowarm.learn.environment import VectorEnvironment
from knowarm.learn.statistics import FinishedEpisodes
from knowarm.policy import PolicyConfig

MakeEnv = Callable[[int, int], VectorEnvironment]
"""Makes (number of environments, number of threads); picklable."""


@dataclass(frozen=True, kw_only=True)
class WorkerJob:
    """All a worker process needs besides the shared memory."""

    index: int
    seed: int
    config: A3CConfig
    policy: PolicyConfig
    make_env: MakeEnv
    table: np.ndarray
    evaluate_every: int | None
    failure_folder: Path | None
    state: Arrays | None
    """What the worker goes on from; None starts new episodes."""


@dataclass(frozen=True, kw_only=True)
class Train:
    """To a worker: go on until the shared steps reach ``total_steps``."""

    total_steps: int


@dataclass(frozen=True, kw_only=True)
class SendState:
    """To a worker: send a `WorkerState`; ``leader`` adds the shared vectors; then perhaps end."""

    leader: bool
    then_end: bool


@dataclass(frozen=True, kw_only=True)
class Record:
    """From a worker: one rollout and its update."""

    steps: int
    """Environment steps of this rollout."""
    staleness: int
    """Updates of other workers since this one read the parameters."""
    policy_loss: float
    value_loss: float
    entropy: float
    grad_norm: float
    episodes: FinishedEpisodes


@dataclass(frozen=True, kw_only=True)
class WorkerState:
    """From a worker: where it stands between two updates."""

    state: Arrays
    steps: int
    updates: int
    values: np.ndarray | None = None
    mean_square: np.ndarray | None = None


@dataclass(frozen=True, kw_only=True)
class Finished:
    """From a worker: the shared steps have reached the total."""


@dataclass(frozen=True, kw_only=True)
class Failure:
    """From a process: it raised and ends."""

    error: str
    """Last line of the traceback."""
    traceback: str
    not_finite: tuple[str, int, Path | None] | None = None
    """Term, step and saved batch, if a number was none."""
    user_error: str | None = None
    """The message, if it is a mistake the user can mend."""


@dataclass(frozen=True, kw_only=True)
class Restarted:
    """From the crew, in place of a process that died: a new one has begun."""
