"""A3C trainer: starts and supervises the workers, logs, evaluates and saves checkpoints."""

import logging
import math
import time
from collections import Counter
from functools import partial
from multiprocessing.connection import wait
from typing import Any

import numpy as np
import torch

from knowarm.learn.a3c.messages import (
    A3CWorkerArgs,
    EvaluationRequest,
    MakeEnv,
    StateRequest,
    UpdateReport,
    WorkerState,
    copy_vectors,
    mean_metrics,
    shared_state_specs,
)
from knowarm.learn.a3c.worker import run_a3c_worker
from knowarm.learn.algorithms import A3CConfig
from knowarm.learn.checkpoint import Arrays, Checkpoint, prefixed, select
from knowarm.learn.evaluation import MAX_PENDING
from knowarm.learn.parallel.processes import (
    ChildProcess,
    SupervisedProcess,
    process_context,
    stop_all,
)
from knowarm.learn.parallel.shared_tensors import (
    FlatParameters,
    SharedTensors,
    unflatten_parameters,
)
from knowarm.learn.trainer import StopReason, Trainer, crossed
from knowarm.policy import Policy

log = logging.getLogger("knowarm.learn")

STATE_S = 5.0
"""Time that the workers have to send their last state once training was asked to stop [s]."""

READ_S = 0.2
"""Longest time to wait for messages of the workers before looking at everything else [s]."""


class A3CTrainer(Trainer):
    """Asynchronous advantage actor-critic (paper section 4.2.1; Mnih et al. 2016).

    Worker processes share parameters and RMSprop statistics and update them asynchronously. With
    one worker, a stopped and resumed training reproduces an uninterrupted one exactly.

    Args:
        config: the algorithm's configuration.
        policy: trained in place; holds the result after `train`.
        make_env: creates the environments of a worker, on the CPU; picklable.
        options: as `Trainer`; each worker has streams of ``seed`` for episodes and actions.
    """

    evaluates_in_background = True

    def __init__(
        self,
        config: A3CConfig,
        policy: Policy,
        make_env: MakeEnv,
        **options: Any,
    ) -> None:
        super().__init__(policy, **options)
        self.config = config
        self._make_env = make_env
        self._parameters = FlatParameters(policy)
        self._context = process_context(getattr(make_env, "__module__", "knowarm"))
        specs = shared_state_specs(self._parameters.values.numel(), config.workers)
        self._shared = SharedTensors(self._context, specs)
        self._shared["values"].copy_(self._parameters.values)
        self._workers: list[SupervisedProcess] = []
        self._restarts: Counter[int] = Counter()  # by worker, as the steps
        self._worker_steps: Counter[int] = Counter()
        self._collectors: dict[int, Arrays] = {}
        self._threshold_factor: float | None = None  # of the worker that reported last
        self._sums: Counter[str] = Counter()
        self._requested_evaluations: set[int] = set()
        self._request = StateRequest(is_last=False)
        self._states: dict[int, WorkerState] = {}
        self._checkpoints = 0  # intervals of steps after each of which one was due

    @property
    def restarts(self) -> int:
        """Restarts of workers so far."""
        return self._restarts.total()

    def _train(self, total_steps: int) -> StopReason:
        self._total_steps = total_steps
        self._begin = time.perf_counter()
        self._row_begin = self._begin
        self._workers = []
        self._shared["paused"].fill_(False)
        reason: StopReason = "finished"
        if self.step == 0 and self.lacks_evaluation:
            values = self._shared.copy("values")
            self._evaluate_once(EvaluationRequest(step=0, values=values))
        try:
            for index in range(self.config.workers):
                start = partial(self._start_worker, index)
                worker = SupervisedProcess(start, self._restarts[index])
                self._workers.append(worker)
            while self._shared["steps"].sum() < total_steps:
                self._read()
                if self._should_stop():
                    reason = "stopped"
                    break
                checkpoints = self.step // self.checkpoint_every
                if checkpoints > self._checkpoints:
                    self._checkpoints = checkpoints
                    if self._collect_states(is_last=False, patience_s=0.0):
                        self._save(self._checkpoint())
            self._collect_states(is_last=True, patience_s=STATE_S)
        finally:
            stop_all([worker.child for worker in self._workers], 0.0)
        self._replace_missing_states()
        self._parameters.values.copy_(self._shared["values"])
        self._collectors = {
            index: state.collector for index, state in self._states.items()
        }
        checkpoint = self._checkpoint()
        if reason == "finished":
            return self._finish(lambda: self._save(checkpoint))
        self._take_evaluations()
        self._save(checkpoint)
        return reason

    def restore(self, checkpoint: Checkpoint) -> None:
        """See `Trainer.restore`."""
        self._shared["values"].copy_(self._parameters.values)
        for name in ("mean_square", "steps"):
            self._shared[name].copy_(torch.from_numpy(checkpoint.optimizer[name]))
        self._shared["evaluated"].fill_(self.step // self.evaluate_every)
        self._collectors = {}
        self._threshold_factor = None
        for index in reversed(range(self.config.workers)):
            state = select(checkpoint.state, f"worker-{index}/")
            if state:
                self._collectors[index] = state
            if "threshold_factor" in state:
                self._threshold_factor = float(state["threshold_factor"])
        self._restarts = Counter(dict(enumerate(checkpoint.facts["restarts"])))
        self._sums = Counter(checkpoint.facts["sums"])
        steps = checkpoint.optimizer["steps"].tolist()
        self._worker_steps = Counter(dict(enumerate(steps)))
        self._checkpoints = self.step // self.checkpoint_every

    def _start_worker(self, index: int, restarts: int) -> ChildProcess:
        self._restarts[index] = restarts
        args = A3CWorkerArgs(
            index=index,
            seed=self.seed,
            restarts=restarts,
            config=self.config,
            total_steps=self._total_steps,
            make_policy=self.policy.maker(),
            make_env=self._make_env,
            evaluate_every=self.evaluate_every if self.evaluates else None,
            failure_folder=self.failure_folder,
            state=self._collectors.get(index) or None,
            threshold_factor=self._threshold_factor,
        )
        assert self._context is not None
        name = f"worker {index}"
        return ChildProcess.start(
            self._context, name, run_a3c_worker, args, self._shared
        )

    def _read(self) -> None:
        """Handle the messages of the workers, waiting briefly for the first one."""
        senders: dict[Any, int] = {}
        for index, worker in enumerate(self._workers):
            has_exited = self._request.is_last and index in self._states
            if not has_exited:
                senders[worker.child.connection] = index
        for connection in wait(senders, READ_S):
            self._read_worker(senders[connection])
        self._take_evaluations()
        self._shared["paused"].fill_(len(self._evaluations.pending()) > MAX_PENDING)

    def _read_worker(self, index: int) -> None:
        """Handle what a worker has sent, up to the state that was requested."""
        worker = self._workers[index]
        while True:
            message = worker.receive(0.0)
            if message is None:
                return
            if isinstance(message, UpdateReport):
                self._add_report(index, message)
            elif not isinstance(message, WorkerState):  # it was restarted
                worker.child.send(self._request)
            elif message.is_last == self._request.is_last:
                self._states[index] = message
                return

    def _add_report(self, index: int, report: UpdateReport) -> None:
        """Count an update; log a row of metrics when due."""
        before = self.step
        steps = int(report.sums["steps"])
        self.step += steps
        self._collectors.pop(index, None)
        self._worker_steps[index] += steps
        self._sums.update(report.sums)
        self._threshold_factor = report.sums["threshold_factor"]
        if crossed(before, self.step, self.config.log_every_steps):
            self._log_row()
        if report.evaluation is not None:
            self._evaluate_once(report.evaluation)

    def _log_row(self) -> None:
        """Log the means since the last row."""
        now = time.perf_counter()
        seconds = max(now - self._row_begin, 1e-9)
        row = {
            "step": self.step,
            "wall_time_s": now - self._begin,
            "steps_per_s": self._sums["steps"] / seconds,
            "updates_per_s": self._sums["updates"] / seconds,
            **mean_metrics(self._sums),
            "restarts": self.restarts,
        }
        for index in range(self.config.workers):
            row[f"worker_{index}_steps"] = self._worker_steps[index]
        self.hooks.on_metrics(row)
        self._row_begin = now
        self._sums = Counter()

    def _collect_states(self, *, is_last: bool, patience_s: float) -> bool:
        """Request the states of all workers; return whether all have sent them.

        Once training is asked to stop, they have some time for it. The first one's state includes
        the shared vectors. With one worker both belong to the same moment; with several the others
        continue meanwhile.
        """
        self._states = {}
        self._request = StateRequest(is_last)
        for worker in self._workers:
            worker.child.send(self._request)
        deadline = math.inf
        while len(self._states) < self.config.workers:
            self._read()
            if self._should_stop():
                deadline = min(deadline, time.monotonic() + patience_s)
            if time.monotonic() >= deadline:
                return False
        return True

    def _replace_missing_states(self) -> None:
        """Record workers that were killed without an answer: resuming starts new episodes there.

        A worker that has not updated, or not since the checkpoint, continues from there.
        """
        missing = sorted(set(range(self.config.workers)) - set(self._states))
        if missing:
            log.warning(
                "No state arrived from the workers %s; they were stopped.", missing
            )
        for index in missing:
            steps = int(self._shared["steps"][index])
            if index not in self._collectors and steps:
                self._restarts[index] += 1  # another stream of random numbers
            self._states[index] = WorkerState(
                is_last=True,
                collector=self._collectors.get(index, {}),
                steps=steps,
                vectors=copy_vectors(self._shared),
            )

    def _checkpoint(self) -> Checkpoint:
        vectors = self._states[0].vectors
        collectors: Arrays = {}
        steps = np.zeros(self.config.workers, np.int64)
        for index, state in sorted(self._states.items()):
            steps[index] = state.steps
            collectors |= prefixed(f"worker-{index}/", state.collector)
        return Checkpoint(
            policy=unflatten_parameters(self.policy, vectors["values"]),
            optimizer={"mean_square": vectors["mean_square"], "steps": steps},
            state=collectors,
            facts={
                "step": int(steps.sum()),
                "restarts": [self._restarts[index] for index in sorted(self._states)],
                "sums": dict(self._sums),
            },
        )

    def _evaluate_once(self, request: EvaluationRequest) -> None:
        """Submit an interim evaluation unless another worker has requested it before."""
        number = request.step // self.evaluate_every
        if number not in self._requested_evaluations:
            self._requested_evaluations.add(number)
            self._evaluate(request.step, request.values)
