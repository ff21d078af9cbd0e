"""A3C trainer: starts and supervises the workers, logs, evaluates and saves checkpoints."""

import time
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
        self._requested_evaluations: set[int] = set()
        self._state_request: SendState | None = None
        self._states: dict[int, WorkerState] = {}
        self._unsaved: Checkpoint | None = None
        self._done: set[int] = set()

    def _train(self, total_steps: int) -> StopReason:
        self._total_steps = total_steps
        self._begin = self._row_begin = time.perf_counter()
        self._done.clear()
        reason: StopReason = "finished"
        if self.step == 0 and self.best.value is None:
            self._evaluate_once(EvaluationRequest(number=0, step=0, values=self._values()))
        self._pool = WorkerPool(self._start_worker, self._worker_restarts)
        try:
            while len(self._done) < self.config.workers:
                self._read()
                if self.hooks.should_stop():
                    reason = "stopped"
                    break
            self._read_until_states_arrived()
            self._request_states(then_exit=True)
            self._read_until_states_arrived()
        finally:
            self._pool.stop()
            self._state_request = None
        self._take_evaluations(wait=True)
        self._save_when_evaluated()
        self._worker_states = {index: state.collector for index, state in self._states.items()}
        self._parameters.values.copy_(self._shared["values"])
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
            state=self._worker_states.pop(index, None),
        )
        assert self._context is not None
        name = f"worker {index}"
        child = ChildProcess.start(self._context, name, run_a3c_worker, args, self._shared)
        child.send(TrainUntil(total_steps=self._total_steps))
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
                self._done.add(index)
            elif isinstance(message, WorkerRestarted):
                self.restarts += 1
                self._done.discard(index)
                if self._state_request is not None and index not in self._states:
                    self._request_state(index)
        self._take_evaluations(wait=False)
        self._save_when_evaluated()

    def _read_until_states_arrived(self) -> None:
        while self._state_request is not None:
            self._read()

    def _add_report(self, index: int, report: UpdateReport) -> None:
        """Count an update; log a row of metrics and request states when due."""
        before = self.step
        self.step += report.steps
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
        if self._state_request is not None or (self._unsaved is not None and not then_exit):
            return
        self._states = {}
        self._state_request = SendState(with_shared=False, then_exit=then_exit)
        for index in range(self.config.workers):
            self._request_state(index)

    def _request_state(self, index: int) -> None:
        assert self._state_request is not None
        then_exit = self._state_request.then_exit
        self._pool.workers[index].send(SendState(with_shared=index == 0, then_exit=then_exit))

    def _add_state(self, index: int, state: WorkerState) -> None:
        assert self._state_request is not None
        self._states[index] = state
        if self._state_request.then_exit:
            self._pool.expect_exit(index)
        if len(self._states) == self.config.workers:
            self._state_request = None
            self._unsaved = self._checkpoint()

    def _save_when_evaluated(self) -> None:
        """Save the checkpoint once all earlier interim evaluations are complete."""
        checkpoint = self._unsaved
        if checkpoint is None:
            return
        pending = self._evaluations.pending_steps() if self._evaluations is not None else []
        if all(step > checkpoint.facts["step"] for step in pending):
            self._unsaved = None
            self._save(checkpoint)

    def _checkpoint(self) -> Checkpoint:
        first = self._states[0]
        assert first.values is not None
        assert first.mean_square is not None
        states = [self._states[index] for index in range(self.config.workers)]
        steps = np.array([state.steps for state in states])
        return Checkpoint(
            policy=unflatten_parameters(self.policy, first.values),
            optimizer={
                "mean_square": first.mean_square,
                "steps": steps,
                "updates": np.array([state.updates for state in states]),
                "evaluated": np.array([int(steps.sum()) // self.evaluate_every]),
            },
            state={
                f"worker-{index}/{name}": value
                for index, state in enumerate(states)
                for name, value in state.collector.items()
            },
            facts={
                "step": int(steps.sum()),
                "restarts": self.restarts,
                "window": self._statistics.to_dict(),
                "lives": list(self._worker_restarts),
            },
        )

    def _evaluate_once(self, request: EvaluationRequest) -> None:
        """Submit an interim evaluation unless another worker has requested it before."""
        if self._evaluations is not None and request.number not in self._requested_evaluations:
            self._requested_evaluations.add(request.number)
            self._evaluations.submit(request.step, request.values)
