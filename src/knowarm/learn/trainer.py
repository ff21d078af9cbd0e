"""Callbacks and counters that every trainer shares."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

from knowarm.policy import Policy

Metrics = dict[str, float]
Evaluate = Callable[[Policy], Metrics]
"""Plays fixed episodes; its ``return_mean`` decides which policy is the best."""


def ignore_metrics(metrics: Metrics) -> None:
    """Take metrics and do nothing."""


def ignore_evaluation(step: int, results: Metrics, is_best: bool) -> None:
    """Take an evaluation and do nothing."""


def never() -> bool:
    """Never stop."""
    return False


@dataclass(frozen=True, kw_only=True)
class Hooks:
    """What the surroundings want to be told, and how they say stop."""

    on_metrics: Callable[[Metrics], None] = ignore_metrics
    """Gets one row an update (PPO) or a log interval (A3C)."""
    on_evaluation: Callable[[int, Metrics, bool], None] = ignore_evaluation
    """Gets step, results and whether they are the best so far."""
    should_stop: Callable[[], bool] = never
    """Asked between updates; true saves a checkpoint and ends `train`."""


@dataclass(frozen=True, kw_only=True)
class TrainingResult:
    """How a call of ``train`` ended."""

    step: int
    """Environment steps taken over the whole training."""
    reason: Literal["finished", "stopped"]
    best_return: float | None
    """Mean return of the best interim evaluation, None without one."""
    best_step: int | None


@dataclass
class Best:
    """The best interim evaluation so far."""

    value: float | None = field(default=None)
    step: int | None = field(default=None)

    def update(self, step: int, value: float) -> bool:
        """Take one result; true if it is better than all before."""
        if self.value is not None and value <= self.value:
            return False
        self.value, self.step = value, step
        return True


def crossed(before: int, after: int, every: int) -> bool:
    """Tell whether a multiple of ``every`` lies in (before, after]."""
    return before // every != after // every
