"""Trainer base class: hooks, interim evaluations, the best policy, checkpoints, resuming."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from multiprocessing.context import BaseContext
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np

from knowarm.learn.checkpoint import (
    Checkpoint,
    CheckpointStore,
    policy_arrays,
    prefixed,
    select,
    to_tensors,
)
from knowarm.learn.evaluation import MAX_PENDING, Evaluations, MakeEvaluate, Metrics
from knowarm.learn.parallel.shared_tensors import (
    flatten_parameters,
    unflatten_parameters,
)
from knowarm.policy import Policy

StopReason = Literal["finished", "stopped"]

_PENDING = "pending-evaluation/"
"""Prefix of the arrays in a checkpoint that hold the parameters of pending evaluations, by step."""

_WAIT_S = 0.2
"""Time between two looks at whether training should stop, while waiting for evaluations [s]."""


@dataclass(frozen=True, kw_only=True)
class Hooks:
    """Functions that a trainer calls."""

    on_metrics: Callable[[Metrics], None] = lambda metrics: None
    """Receives one row of metrics per update (PPO) or log interval (A3C)."""
    on_evaluation: Callable[[int, Metrics, bool], None] = (
        lambda step, results, is_best: None
    )
    """Receives step, results, and whether they are the best so far."""
    should_stop: Callable[[], bool] = lambda: False
    """Called between updates; true saves a checkpoint and ends `Trainer.train`."""


@dataclass(frozen=True, kw_only=True)
class TrainingResult:
    """How a call of `Trainer.train` ended."""

    step: int
    """Environment steps since the start of training, resumed parts included."""
    reason: StopReason
    """Whether all steps were taken or the hook ended training."""
    best_return: float | None
    """Mean return of the best interim evaluation; None without one."""
    best_step: int | None
    """Step of the best interim evaluation."""


class Trainer(ABC):
    """Base class of the trainers.

    Args:
        policy: trained in place.
        seed: of the run, 0 or more; each purpose of randomness derives a stream of its own from
            it (`knowarm.seeding`).
        make_evaluate: creates the function that plays an interim evaluation; None for none.
        evaluate_every: steps between two interim evaluations; the first precedes training, and one
            follows the last step.
        hooks: functions to call.
        checkpoints: where checkpoints are saved; None saves none.
        checkpoint_every: steps between two checkpoints.
        failure_folder: where a rollout with non-finite values is saved; None saves nothing.

    Attributes:
        evaluates_in_background: whether a child process plays the interim evaluations while
            training continues, for which ``make_evaluate`` is picklable. Results may arrive after
            later steps. Checkpoints do not wait for them: they hold the parameters of pending
            evaluations, which are played after resuming.
        step: environment steps so far.
        pending_evaluations: parameters by step of the interim evaluations that were pending in
            the checkpoint that `resume` restored; `train` plays them.
    """

    evaluates_in_background: ClassVar[bool] = False

    def __init__(
        self,
        policy: Policy,
        *,
        seed: int,
        make_evaluate: MakeEvaluate | None = None,
        evaluate_every: int = 50_000,
        hooks: Hooks | None = None,
        checkpoints: CheckpointStore | None = None,
        checkpoint_every: int = 200_000,
        failure_folder: Path | None = None,
    ) -> None:
        self.policy = policy
        self.seed = seed
        self.step = 0
        self._best_return: float | None = None
        self._best_step: int | None = None
        self._evaluated_step: int | None = None  # of the latest interim evaluation
        self.pending_evaluations: dict[int, np.ndarray] = {}
        self.hooks = hooks or Hooks()
        self.checkpoints = checkpoints
        self.checkpoint_every = checkpoint_every
        self.evaluate_every = evaluate_every
        self.failure_folder = failure_folder
        self._make_evaluate = make_evaluate
        self._evaluations = Evaluations(policy, None)
        self._context: BaseContext | None = None
        self._stopping = False

    @property
    def evaluates(self) -> bool:
        """Whether there are interim evaluations."""
        return self._make_evaluate is not None

    def train(self, total_steps: int) -> TrainingResult:
        """Train until ``total_steps`` environment steps were taken in total.

        Schedules extend over ``total_steps``, so a resumed training must be given the same number
        to reproduce an uninterrupted one.

        Raises:
            NotFiniteError: a loss, gradient or input is not finite.
            UserError: a checkpoint cannot be written.
            RuntimeError: a child process exits or fails repeatedly.
        """
        self._stopping = False
        self._evaluations = Evaluations(
            self.policy,
            self._make_evaluate,
            in_background=self.evaluates_in_background,
            context=self._context,
        )
        try:
            for step, values in sorted(self.pending_evaluations.items()):
                self._evaluations.submit(step, values)
            self.pending_evaluations = {}
            self._take_evaluations()
            reason = self._train(total_steps)
        finally:
            self._evaluations.close()
        return TrainingResult(
            step=self.step,
            reason=reason,
            best_return=self._best_return,
            best_step=self._best_step,
        )

    def resume(self) -> None:
        """Restore the latest intact checkpoint.

        Raises:
            UserError: there is none, or it belongs to another run.
        """
        assert self.checkpoints is not None, "resuming needs a checkpoint store"
        checkpoint = self.checkpoints.load()
        facts = checkpoint.facts
        self.policy.load_state_dict(to_tensors(checkpoint.policy))
        self.step = facts["step"]
        self._best_return = facts["best_return"]
        self._best_step = facts["best_step"]
        self._evaluated_step = facts.get("evaluated_step", self._best_step)
        if self.evaluates:
            pending = select(checkpoint.state, _PENDING)
            self.pending_evaluations = {
                int(step): values for step, values in pending.items()
            }
        self.restore(checkpoint)

    @abstractmethod
    def _train(self, total_steps: int) -> StopReason:
        """Train; see `train`."""

    @abstractmethod
    def restore(self, checkpoint: Checkpoint) -> None:
        """Restore what `resume` does not: optimizer, environments, generators, counters."""

    def _save(self, checkpoint: Checkpoint) -> None:
        """Save a checkpoint, if there is a store, with the best and the pending evaluations."""
        if self.checkpoints is None:
            return
        facts = {
            "step": self.step,
            **checkpoint.facts,
            "best_return": self._best_return,
            "best_step": self._best_step,
            "evaluated_step": self._evaluated_step,
        }
        # The checkpoint may be older than this moment, and so than an evaluation.
        pending = {
            str(step): values
            for step, values in self._evaluations.pending()
            if step <= facts["step"]
        }
        facts["pending"] = len(pending)
        state = checkpoint.state | prefixed(_PENDING, pending)
        self.checkpoints.save(replace(checkpoint, state=state, facts=facts))

    def _should_stop(self) -> bool:
        """Tell whether the hook has asked to stop, now or before."""
        self._stopping = self._stopping or self.hooks.should_stop()
        return self._stopping

    @property
    def lacks_evaluation(self) -> bool:
        """Whether the present policy is still to be evaluated, as before and after training."""
        return self.evaluates and self._evaluated_step != self.step

    def parameters(self) -> np.ndarray:
        """Copy the parameters that interim evaluations play, those of the policy."""
        return flatten_parameters(self.policy)

    def _evaluate(self, step: int, values: np.ndarray) -> None:
        """Submit an interim evaluation of the parameters ``values`` (P,)."""
        self._evaluated_step = step
        self._evaluations.submit(step, values)

    def _wait_for_evaluations(self, *, leave: int = 0) -> bool:
        """Wait until at most ``leave`` are pending; return whether training was not stopped."""
        self._take_evaluations()
        while len(self._evaluations.pending()) > leave:
            if self._should_stop():
                return False
            self._take_evaluations(timeout_s=_WAIT_S)
        return True

    def _finish(self, save: Callable[[], None]) -> StopReason:
        """Evaluate the last policy, save it, wait for evaluations, and save their results."""
        if self.lacks_evaluation:
            self._evaluate(self.step, self.parameters())
        self._take_evaluations()
        save()
        if not self._evaluations.pending():
            return "finished"
        # Saved before the wait, so that a training that is killed meanwhile has lost nothing.
        is_complete = self._wait_for_evaluations()
        save()
        if is_complete:
            return "finished"
        return "stopped"

    def _take_evaluations(self, *, timeout_s: float = 0.0) -> None:
        """Report completed evaluations to the hooks and save the best policy."""
        for step, values, results in self._evaluations.completed(timeout_s=timeout_s):
            mean = results["return_mean"]
            is_best = self._best_return is None or mean > self._best_return
            if is_best:
                self._best_return = mean
                self._best_step = step
            if is_best and self.checkpoints is not None:
                parameters = unflatten_parameters(self.policy, values)
                facts = {"step": step, **results}
                self.checkpoints.save_best(Checkpoint(policy=parameters, facts=facts))
            self.hooks.on_evaluation(step, results, is_best)


class UntrainedTrainer(Trainer):
    """Saves the initial weights and ends, for agents that act without a policy; see `Trainer`."""

    def _train(self, total_steps: int) -> StopReason:
        self.step = total_steps
        if self.checkpoints is not None:
            facts = {"step": self.step}
            checkpoint = Checkpoint(policy=policy_arrays(self.policy), facts=facts)
            self.checkpoints.save_best(checkpoint)
            self._save(checkpoint)
        return "finished"

    def restore(self, checkpoint: Checkpoint) -> None:
        """Restore nothing more."""


class SynchronousTrainer(Trainer):
    """Base class of trainers that take steps and learn from them in turn; see `Trainer`."""

    @abstractmethod
    def update(self, total_steps: int) -> Metrics:
        """Take some steps, add their number to ``step``, learn, and return a row of metrics."""

    @abstractmethod
    def checkpoint(self) -> Checkpoint:
        """Return all that `restore` needs to continue identically."""

    def save(self) -> None:
        """Save a checkpoint now, if there is a store."""
        if self.checkpoints is not None:
            self._save(self.checkpoint())

    def _train(self, total_steps: int) -> StopReason:
        begin = time.perf_counter()
        # The untrained policy is the first point of the learning curve.
        if self.step == 0 and self.lacks_evaluation:
            self._submit_evaluation()
        while self.step < total_steps:
            if self._should_stop():
                self._take_evaluations()
                self.save()
                return "stopped"
            before = self.step
            start = time.perf_counter()
            metrics = self.update(total_steps)
            now = time.perf_counter()
            row = {
                "step": self.step,
                "wall_time_s": now - begin,
                "steps_per_s": (self.step - before) / (now - start),
            }
            self.hooks.on_metrics(row | metrics)
            if crossed(before, self.step, self.evaluate_every):
                self._submit_evaluation()
            self._take_evaluations()
            if crossed(before, self.step, self.checkpoint_every):
                self.save()
        return self._finish(self.save)

    def _submit_evaluation(self) -> None:
        self._evaluate(self.step, self.parameters())
        self._wait_for_evaluations(leave=MAX_PENDING)


def crossed(before: int, after: int, every: int) -> bool:
    """Tell whether a multiple of ``every`` lies in (before, after]."""
    return before // every != after // every
