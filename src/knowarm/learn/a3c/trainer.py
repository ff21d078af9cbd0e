"""A policy, an environment factory and knowledge go in; workers train it, and this one watches."""

import dataclasses
import time
from pathlib import Path
from typing import Literal

import numpy as np
import torch

from knowarm.learn.a3c.crew import Crew
from knowarm.learn.a3c.memory_check import check_memory
from knowarm.learn.a3c.messages import (
    Finished,
    MakeEnv,
    Record,
    Restarted,
    SendState,
    Train,
    WorkerJob,
    WorkerState,
)
from knowarm.learn.a3c.shared import SharedLearning
from knowarm.learn.a3c.window import Window
from knowarm.learn.a3c.worker import run_worker
from knowarm.learn.checkpoint import Arrays, Checkpoint, CheckpointStore, policy_arrays
from knowarm.learn.collector import below
from knowarm.learn.config import A3CConfig
from knowarm.learn.evaluator import Evaluation, MakeEvaluate, Snapshot, run_evaluator
from knowarm.learn.flat import FlatParameters
from knowarm.learn.processes import Child, process_context
from knowarm.learn.trainer import Best, Hooks, TrainingResult, crossed
from knowarm.policy import Policy

SEED_STRIDE = 1_000_003
"""Between the seeds of two workers; more environments than a worker will ever have."""


class A3CTrainer:
    """Asynchronous advantage actor-critic (paper section 4.2.1; Mnih et al. 2016).

    Worker processes share parameters and RMSprop statistics and update them without waiting for
    one another; one more process plays the interim evaluation. This object starts and watches
    them, collects their records, and keeps checkpoints. With one worker, a stopped and resumed
    training equals an uninterrupted one to the byte.

    Args:
        config: all choices.
        policy: trained in place; it holds the result after `train`.
        make_env: picklable; makes (number of environments, number of threads).
        knowledge_table: (F, K) float32, one row a facet of the environment.
        seed: of episodes and actions; each worker derives its own.
        make_evaluate: picklable; makes the function that plays the interim evaluation.
        evaluate_every: steps between two interim evaluations; the first is before training.
        hooks: who is told of metrics and evaluations.
        checkpoints: where checkpoints go; None keeps none.
        checkpoint_every: steps between two checkpoints.
        failure_folder: where a batch with a NaN is saved; None saves nothing.

    Raises:
        UserError: the free memory does not hold so many workers.
    """

    def __init__(
        self,
        config: A3CConfig,
        policy: Policy,
        make_env: MakeEnv,
        knowledge_table: np.ndarray,
        *,
        seed: int,
        make_evaluate: MakeEvaluate | None = None,
        evaluate_every: int = 50_000,
        hooks: Hooks | None = None,
        checkpoints: CheckpointStore | None = None,
        checkpoint_every: int = 200_000,
        failure_folder: Path | None = None,
    ) -> None:
        self.config = config
        self.policy = policy
        self.step = 0
        self.best = Best()
        self.restarts = 0
        self._make_env = make_env
        self._table = np.array(knowledge_table, np.float32)
        self._seed = seed
        self._make_evaluate = make_evaluate
        self._evaluate_every = evaluate_every
        self._hooks = hooks or Hooks()
        self._checkpoints = checkpoints
        self._checkpoint_every = checkpoint_every
        self._failure_folder = failure_folder
        self._flat = FlatParameters(policy)
        check_memory(
            config,
            image_bytes=3 * policy.config.image_size**2,
            parameters=self._flat.values.numel(),
        )
        self._context = process_context(
            ["knowarm.learn.a3c.worker", getattr(make_env, "__module__", "knowarm")]
        )
        self._shared = SharedLearning(self._context, self._flat.values.numel(), config.workers)
        self._shared.values.copy_(self._flat.values)
        self._window = Window()
        self._worker_steps = [0] * config.workers
        self._lives = [0] * config.workers
        self._states: dict[int, Arrays] = {}
        self._snapshots: list[Snapshot] = []
        self._request: SendState | None = None
        self._replies: dict[int, WorkerState] = {}
        self._unsaved: Checkpoint | None = None
        self._finished: set[int] = set()

    def train(self, total_steps: int) -> TrainingResult:
        """Train until ``total_steps`` environment steps were taken in all.

        Raises:
            NotFiniteError: a worker met a NaN or an infinity.
            UserError: a checkpoint cannot be written.
            RuntimeError: a worker fails again and again; the message holds its traceback.
        """
        self._total_steps = total_steps
        self._begin = self._row_began = time.perf_counter()
        self._finished.clear()
        reason: Literal["finished", "stopped"] = "finished"
        untrained = Snapshot(number=0, step=0, values=self._values())
        self._crew = Crew(
            self._start_worker,
            self._start_evaluator if self._make_evaluate is not None else None,
            self._lives,
        )
        try:
            if self._make_evaluate is not None and self.step == 0:
                self._evaluate(untrained)
            while len(self._finished) < self.config.workers:
                self._read()
                if self._hooks.should_stop():
                    reason = "stopped"
                    break
            self._read_until_answered()
            self._ask(then_end=True)
            self._read_until_answered()
            while self._snapshots:
                self._read()
        finally:
            self._crew.end()
            self._request = None
        self._states = {index: reply.state for index, reply in self._replies.items()}
        self._flat.values.copy_(self._shared.values)
        return TrainingResult(
            step=self.step,
            reason=reason,
            best_return=self.best.value,
            best_step=self.best.step,
        )

    def resume(self) -> None:
        """Go on from the latest whole checkpoint.

        Raises:
            UserError: there is none, or it belongs to something else.
        """
        assert self._checkpoints is not None, "resuming needs a checkpoint store"
        checkpoint = self._checkpoints.load()
        self.policy.load_state_dict({k: torch.from_numpy(v) for k, v in checkpoint.policy.items()})
        self._shared.values.copy_(self._flat.values)
        for name in ("mean_square", "steps", "updates", "evaluated"):
            getattr(self._shared, name).copy_(torch.from_numpy(checkpoint.optimizer[name]))
        self._states = {
            index: state
            for index in range(self.config.workers)
            if (state := below(checkpoint.state, f"worker-{index}/"))
        }
        facts = checkpoint.facts
        self.step = facts["step"]
        self.restarts = facts["restarts"]
        self.best = Best(facts["best_return"], facts["best_step"])
        self._window = Window(**facts["window"])
        self._lives = facts["lives"]
        self._worker_steps = checkpoint.optimizer["steps"].tolist()

    def _values(self) -> np.ndarray:
        return self._shared.values.numpy().copy()

    def _start_worker(self, index: int, life: int) -> Child:
        job = WorkerJob(
            index=index,
            seed=self._seed + SEED_STRIDE * (1 + index + self.config.workers * life),
            config=self.config,
            policy=self.policy.config,
            make_env=self._make_env,
            table=self._table,
            evaluate_every=self._evaluate_every if self._make_evaluate else None,
            failure_folder=self._failure_folder,
            state=self._states.pop(index, None),
        )
        child = Child.start(self._context, f"worker {index}", run_worker, job, self._shared)
        child.send(Train(total_steps=self._total_steps))
        return child

    def _start_evaluator(self) -> Child:
        return Child.start(
            self._context, "evaluator", run_evaluator, self.policy.config, self._make_evaluate
        )

    def _read(self) -> None:
        """Take what the processes have sent, waiting a moment for something to come."""
        for index, message in self._crew.read(0.2):
            if index is None:
                if isinstance(message, Evaluation):
                    self._evaluated(message)
                if self._snapshots:
                    self._send_to_evaluator()
            elif isinstance(message, Record):
                self._record(index, message)
            elif isinstance(message, Snapshot):
                self._evaluate(message)
            elif isinstance(message, WorkerState):
                self._take_state(index, message)
            elif isinstance(message, Finished):
                self._finished.add(index)
            elif isinstance(message, Restarted):
                self.restarts += 1
                self._finished.discard(index)
                if self._request is not None and index not in self._replies:
                    self._ask_one(index)

    def _read_until_answered(self) -> None:
        while self._request is not None:
            self._read()

    def _record(self, index: int, record: Record) -> None:
        """Count one update; write a row and ask for a checkpoint when they are due."""
        before = self.step
        self.step += record.steps
        self._worker_steps[index] += record.steps
        self._window.add(record)
        if crossed(before, self.step, self.config.log_every_steps):
            now = time.perf_counter()
            seconds = now - self._row_began
            self._hooks.on_metrics(
                {
                    "step": self.step,
                    "wall_time_s": now - self._begin,
                    "steps_per_s": self._window.steps / seconds,
                    "updates_per_s": self._window.updates / seconds,
                    **self._window.row(),
                    "restarts": self.restarts,
                    **{f"worker_{i}_steps": n for i, n in enumerate(self._worker_steps)},
                }
            )
            self._row_began = now
            self._window = Window()
        if crossed(before, self.step, self._checkpoint_every):
            self._ask(then_end=False)

    def _ask(self, *, then_end: bool) -> None:
        """Ask all workers where they stand; the first one answers with the shared vectors too.

        With one worker vectors and state belong together to the byte. With more, the others go on
        meanwhile, which a restart from the checkpoint cannot notice.
        """
        if self._request is not None or (self._unsaved is not None and not then_end):
            return
        self._replies = {}
        self._request = SendState(leader=False, then_end=then_end)
        for index in range(self.config.workers):
            self._ask_one(index)

    def _ask_one(self, index: int) -> None:
        assert self._request is not None
        request = SendState(leader=index == 0, then_end=self._request.then_end)
        self._crew.workers[index].send(request)

    def _take_state(self, index: int, state: WorkerState) -> None:
        assert self._request is not None
        self._replies[index] = state
        if self._request.then_end:
            self._crew.dismiss(index)
        if len(self._replies) == self.config.workers:
            self._request = None
            self._unsaved = self._checkpoint()
            self._save_when_evaluated()

    def _save_when_evaluated(self) -> None:
        """Write the checkpoint once the evaluations asked for before it have their results."""
        checkpoint = self._unsaved
        if checkpoint is None:
            return
        if all(snapshot.step > checkpoint.facts["step"] for snapshot in self._snapshots):
            self._unsaved = None
            if self._checkpoints is not None:
                best = {"best_return": self.best.value, "best_step": self.best.step}
                facts = {**checkpoint.facts, **best}
                self._checkpoints.save(dataclasses.replace(checkpoint, facts=facts))

    def _checkpoint(self) -> Checkpoint:
        leader = self._replies[0]
        assert leader.values is not None
        assert leader.mean_square is not None
        replies = [self._replies[index] for index in range(self.config.workers)]
        steps = np.array([reply.steps for reply in replies])
        return Checkpoint(
            policy=self._arrays(leader.values),
            optimizer={
                "mean_square": leader.mean_square,
                "steps": steps,
                "updates": np.array([reply.updates for reply in replies]),
                "evaluated": np.array([int(steps.sum()) // self._evaluate_every]),
            },
            state={
                f"worker-{index}/{name}": value
                for index, reply in enumerate(replies)
                for name, value in reply.state.items()
            },
            facts={
                "step": int(steps.sum()),
                "restarts": self.restarts,
                "window": self._window.facts(),
                "lives": list(self._lives),
            },
        )

    def _arrays(self, values: np.ndarray) -> Arrays:
        """Parameters by name, from the vector of all of them."""
        self._flat.values.copy_(torch.from_numpy(values))
        return policy_arrays(self.policy)

    def _evaluate(self, snapshot: Snapshot) -> None:
        """Queue a snapshot for the evaluator, unless another worker's came first."""
        if all(snapshot.number != earlier.number for earlier in self._snapshots):
            self._snapshots.append(snapshot)
            if len(self._snapshots) == 1:
                self._send_to_evaluator()

    def _send_to_evaluator(self) -> None:
        # One at a time: the pipe is small and sending to a busy process would wait for it.
        assert self._crew.evaluator is not None
        self._crew.evaluator.send(self._snapshots[0])

    def _evaluated(self, evaluation: Evaluation) -> None:
        snapshot = self._snapshots.pop(0)
        assert snapshot.number == evaluation.number
        is_best = self.best.update(snapshot.step, evaluation.results["return_mean"])
        if is_best and self._checkpoints is not None:
            facts = {"step": snapshot.step, **evaluation.results}
            self._checkpoints.save_best(
                Checkpoint(policy=self._arrays(snapshot.values), facts=facts)
            )
        self._hooks.on_evaluation(snapshot.step, evaluation.results, is_best)
        self._save_when_evaluated()
