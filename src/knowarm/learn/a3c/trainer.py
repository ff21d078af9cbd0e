"""A3C trainer: starts and supervises the workers, logs, evaluates and saves checkpoints."""

import logging
import math
import time
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from knowarm.learn.a3c.messages import (
    A3CWorkerArgs,
    EvaluationRequest,
    MakeEnv,
    SendState,
    TotalReached,
    TrainUntil,
    UpdateReport,
    UpdateStatistics,
    WorkerRestarted,
    WorkerState,
)
from knowarm.learn.a3c.shared_state import shared_state_specs
from knowarm.learn.a3c.worker import run_a3c_worker
from knowarm.learn.a3c.worker_pool import WorkerPool, check_memory
from knowarm.learn.checkpoint import Arrays, Checkpoint
from knowarm.learn.collector import select
from knowarm.learn.config import A3CConfig
from knowarm.learn.flat_parameters import FlatParameters, unflatten_parameters
from knowarm.learn.processes import ChildProcess, process_context
from knowarm.learn.shared_tensors import SharedTensors
from knowarm.learn.trainer import StopReason, Trainer, crossed
from knowarm.policy import Policy

log = logging.getLogger("knowarm.learn")

STATE_S = 5.0
"""Time that the workers have to send their last state once training was asked to stop [s]."""


class A3CTrainer(Trainer):
    """Asynchronous advantage actor-critic (paper section 4.2.1; Mnih et al. 2016).

    Worker processes share parameters and RMSprop statistics and update them asynchronously. With
    one worker, a stopped and resumed training reproduces an uninterrupted one exactly.

    Args:
        config: the algorithm's configuration.
        policy: trained in place; holds the result after `train`.
        make_env: creates the environments of a worker, on the CPU; picklable.
        seed: of the run; episodes and actions of each worker have a stream each.
        options: as `Trainer`.

    Attributes:
        restarts: restarts of workers so far.

    Raises:
        UserError: the free memory is too small for the workers.
    """

    def __init__(
        self, config: A3CConfig, policy: Policy, make_env: MakeEnv, *, seed: int, **options: Any
    ) -> None:
        super().__init__(policy, seed=seed, **options)
        self.config = config
        self.restarts = 0
        self._make_env = make_env
        self._parameters = FlatParameters(policy)
        count = self._parameters.values.numel()
        check_memory(config, image_bytes=3 * policy.shape.image_size**2, parameters=count)
        self._context = context = process_context(
            ["knowarm.learn.a3c.worker", getattr(make_env, "__module__", "knowarm")]
        )
        self._shared = SharedTensors(context, shared_state_specs(count, config.workers))
        self._shared["values"].copy_(self._parameters.values)
        self._statistics = UpdateStatistics()
        self._worker_steps = [0] * config.workers
        self._worker_restarts = [0] * config.workers
        self._worker_states: dict[int, Arrays] = {}
        self._requested_evaluations: dict[int, int] = {}
        self._evaluated = 0
        self._request: SendState | None = None
        self._requests = 0
        self._states: dict[int, WorkerState] = {}
        self._checkpoint_due = False
        self._paused = False
        self._done: set[int] = set()

    def _train(self, total_steps: int) -> StopReason:
        self._total_steps = total_steps
        self._begin = self._row_begin = time.perf_counter()
        self._done.clear()
        self._paused = False
        reason: StopReason = "finished"
        if self._evaluates_start:
            self._evaluate_once(EvaluationRequest(number=0, step=0, values=self._values()))
        self._pool = WorkerPool(self._start_worker, self._worker_restarts, self._should_stop)
        try:
            while len(self._done) < self.config.workers:
                self._read()
                if self._should_stop():
                    reason = "stopped"
                    break
            self._collect_last_states()
        finally:
            self._pool.stop()
            self._request = None
        self._parameters.values.copy_(self._shared["values"])
        self._worker_states = {index: state.collector for index, state in self._states.items()}
        checkpoint = self._checkpoint()
        if reason == "finished":
            return self._finish(lambda: self._save(checkpoint))
        self._take_evaluations()
        self._save(checkpoint)
        return reason

    def _restore(self, checkpoint: Checkpoint) -> None:
        self._shared["values"].copy_(self._parameters.values)
        for name in ("mean_square", "steps", "updates", "evaluated"):
            self._shared[name].copy_(torch.from_numpy(checkpoint.optimizer[name]))
        self._worker_states = {
            index: state
            for index in range(self.config.workers)
            if (state := select(checkpoint.state, f"worker-{index}/"))
        }
        facts = checkpoint.facts
        self.restarts = facts["restarts"]
        self._statistics = UpdateStatistics(**facts["window"])
        self._worker_restarts = facts["lives"]
        self._worker_steps = checkpoint.optimizer["steps"].tolist()
        self._evaluated = int(checkpoint.optimizer["evaluated"][0])

    def _values(self) -> np.ndarray:
        return self._shared["values"].numpy().copy()

    def _start_worker(self, index: int, restarts: int) -> ChildProcess:
        args = A3CWorkerArgs(
            index=index,
            seed=self.seed,
            restarts=restarts,
            config=self.config,
            policy=self.policy.spec(),
            make_env=self._make_env,
            evaluate_every=self.evaluate_every if self.evaluates else None,
            failure_folder=self.failure_folder,
            state=self._worker_states.get(index),
        )
        assert self._context is not None
        name = f"worker {index}"
        child = ChildProcess.start(self._context, name, run_a3c_worker, args, self._shared)
        child.send(TrainUntil(total_steps=0 if self._paused else self._total_steps))
        return child

    def _read(self) -> None:
        """Handle the messages of the workers, waiting briefly for the first one."""
        for index, message in self._pool.read(0.2):
            if isinstance(message, UpdateReport):
                self._add_report(index, message)
            elif isinstance(message, EvaluationRequest):
                self._evaluate_once(message)
            elif isinstance(message, WorkerState):
                self._add_state(index, message)
            elif isinstance(message, TotalReached):
                if self._shared["steps"].sum() >= self._total_steps:
                    self._done.add(index)
            elif isinstance(message, WorkerRestarted):
                self.restarts += 1
                self._done.discard(index)
                if self._request is not None and index not in self._states:
                    self._add_state(index, self._last_state(index))
        self._take_evaluations()
        if self._evaluator_is_behind != self._paused:
            self._pause(self._evaluator_is_behind)

    def _pause(self, is_paused: bool) -> None:
        """Pause or continue all workers; they answer requests for their state meanwhile."""
        self._paused = is_paused
        for worker in self._pool.workers:
            worker.send(TrainUntil(total_steps=0 if is_paused else self._total_steps))

    def _collect_last_states(self) -> None:
        """Let every worker send its state and exit.

        When training was asked to stop, a worker without an answer after `STATE_S` is left out: it
        starts new episodes when training resumes.
        """
        self._request_states(then_exit=True)
        for index in range(len(self._pool.workers), self.config.workers):  # not even started
            self._add_state(index, self._last_state(index))
        deadline = math.inf
        while self._request is not None:
            self._read()
            if self._should_stop():
                deadline = min(deadline, time.monotonic() + STATE_S)
            if time.monotonic() > deadline:
                silent = [i for i in range(self.config.workers) if i not in self._states]
                log.warning("No state arrived from the workers %s; stopping them.", silent)
                for index in silent:
                    self._add_state(index, self._last_state(index))

    def _add_report(self, index: int, report: UpdateReport) -> None:
        """Count an update; log a row of metrics and request states when due."""
        before = self.step
        self.step += report.steps
        self._worker_states.pop(index, None)
        self._worker_steps[index] += report.steps
        self._statistics.add(report)
        if crossed(before, self.step, self.config.log_every_steps):
            now = time.perf_counter()
            seconds = max(now - self._row_begin, 1e-9)
            self.hooks.on_metrics(
                {
                    "step": self.step,
                    "wall_time_s": now - self._begin,
                    "steps_per_s": self._statistics.steps / seconds,
                    "updates_per_s": self._statistics.updates / seconds,
                    **self._statistics.metrics(),
                    "restarts": self.restarts,
                    **{f"worker_{i}_steps": n for i, n in enumerate(self._worker_steps)},
                }
            )
            self._row_begin = now
            self._statistics = UpdateStatistics()
        if crossed(before, self.step, self.checkpoint_every):
            self._request_states(then_exit=False)

    def _request_states(self, *, then_exit: bool) -> None:
        """Request the states of all workers; the first one's includes the shared vectors.

        With one worker, vectors and state belong to the same moment. With several, the others
        continue meanwhile, as they would after a restart.
        """
        if self._request is not None and not then_exit:
            self._checkpoint_due = True
            return
        self._checkpoint_due = False
        self._requests += 1
        self._states = {}
        self._request = SendState(number=self._requests, with_shared=False, then_exit=then_exit)
        for index, worker in enumerate(self._pool.workers):
            worker.send(replace(self._request, with_shared=index == 0))

    def _add_state(self, index: int, state: WorkerState) -> None:
        """Take the state of a worker; save a checkpoint with the last one."""
        request = self._request
        if request is None or state.number != request.number:
            return  # the answer to a request that the last one replaced
        self._states[index] = state
        if request.then_exit:
            self._pool.expect_exit(index)
        if len(self._states) == self.config.workers:
            self._request = None
            if not request.then_exit:
                self._save(self._checkpoint())
                if self._checkpoint_due:
                    self._request_states(then_exit=False)

    def _last_state(self, index: int) -> WorkerState:
        """State of a worker that cannot send it: new episodes, unless it has not updated yet."""
        assert self._request is not None
        shared = self._shared
        return WorkerState(
            number=self._request.number,
            collector=self._worker_states.get(index, {}),
            steps=int(shared["steps"][index]),
            updates=int(shared["updates"][index]),
            values=self._values(),
            mean_square=shared["mean_square"].numpy().copy(),
        )

    def _checkpoint(self) -> Checkpoint:
        first = self._states[0]
        assert first.values is not None
        assert first.mean_square is not None
        states = [self._states[index] for index in range(self.config.workers)]
        steps = np.array([state.steps for state in states])
        step = int(steps.sum())
        # A worker may have requested an evaluation after another one sent its state.
        requested = [n for n, at in self._requested_evaluations.items() if at <= step]
        return Checkpoint(
            policy=unflatten_parameters(self.policy, first.values),
            optimizer={
                "mean_square": first.mean_square,
                "steps": steps,
                "updates": np.array([state.updates for state in states]),
                "evaluated": np.array([max([self._evaluated, *requested])]),
            },
            state={
                f"worker-{index}/{name}": value
                for index, state in enumerate(states)
                for name, value in state.collector.items()
            },
            facts={
                "step": step,
                "restarts": self.restarts,
                "window": self._statistics.to_dict(),
                "lives": list(self._worker_restarts),
            },
        )

    def _evaluate_once(self, request: EvaluationRequest) -> None:
        """Submit an interim evaluation unless another worker has requested it before."""
        if self._evaluations is not None and request.number not in self._requested_evaluations:
            self._requested_evaluations[request.number] = request.step
            self._evaluations.submit(request.step, request.values)
