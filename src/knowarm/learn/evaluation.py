"""Interim evaluations during training: in the training process or in a background process."""

import logging
import os
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.context import BaseContext

import numpy as np
import torch

from knowarm.cores import limited_to
from knowarm.learn.flat_parameters import FlatParameters
from knowarm.learn.processes import (
    ChildProcess,
    ProcessFailure,
    prepare_child_process,
    process_context,
)
from knowarm.learn.shared_tensors import SharedTensors
from knowarm.policy import Policy, PolicySpec

log = logging.getLogger("knowarm.learn")

Metrics = dict[str, float]
"""Values by name."""
Evaluate = Callable[[Policy], Metrics]
"""Plays fixed episodes with a policy; its ``return_mean`` determines the best policy."""
MakeEvaluate = Callable[[], Evaluate]
"""Creates the function that plays the fixed episodes; picklable."""

MAX_PENDING = 8
"""Evaluations that may be pending before training pauses for the evaluator."""

MAX_EXITS = 3
"""Consecutive exits of the evaluator without a result after which training stops."""


@dataclass(frozen=True)
class CompletedEvaluation:
    """Result of one interim evaluation."""

    step: int
    values: np.ndarray
    """(P,) float32, the parameters of the evaluated policy; see `FlatParameters`."""
    results: Metrics


@dataclass(frozen=True)
class EvaluateShared:
    """To the evaluator: evaluate the policy with the parameters in shared memory."""


class InlineEvaluations:
    """Runs each evaluation when it is submitted, while training waits.

    Args:
        policy: structure and knowledge of the policy.
        evaluate: plays the fixed episodes.
    """

    def __init__(self, policy: PolicySpec, evaluate: Evaluate) -> None:
        self._policy = policy.build()
        self._parameters = FlatParameters(self._policy)
        self._evaluate = evaluate
        self._completed: list[CompletedEvaluation] = []

    def submit(self, step: int, values: np.ndarray) -> None:
        """Evaluate the policy with the parameters ``values`` (P,)."""
        self._parameters.values.copy_(torch.from_numpy(values))
        self._completed.append(CompletedEvaluation(step, values, self._evaluate(self._policy)))

    def completed(self, *, timeout_s: float) -> list[CompletedEvaluation]:
        """Return the evaluations that completed since the last call, in order of submission.

        Args:
            timeout_s: longest time to wait for the next result, if one is pending [s].
        """
        completed, self._completed = self._completed, []
        return completed

    def pending(self) -> list[tuple[int, np.ndarray]]:
        """Return step and parameters of the submitted evaluations without a result."""
        return []

    def close(self) -> None:
        """Release resources: none."""


class BackgroundEvaluations:
    """Runs evaluations in a child process while training continues.

    Args:
        policy: structure and knowledge of the policy.
        make_evaluate: called in the child process; picklable.
        context: start method of the child process; by default `process_context`.
        threads: threads of the child process, for the policy too; None for one thread of PyTorch,
            since training on the CPU needs the cores, and as many others as the environment uses.
    """

    def __init__(
        self,
        policy: PolicySpec,
        make_evaluate: MakeEvaluate,
        context: BaseContext | None = None,
        threads: int | None = None,
    ) -> None:
        self.restarts = 0
        self._context = context or process_context(["knowarm.learn.evaluation"])
        # Parameters do not fit into a pipe: sending them would block while the child starts.
        parameters = sum(p.numel() for p in policy.build().parameters())
        specs = {"values": ((parameters,), torch.float32)}
        self._shared = SharedTensors(self._context, specs)
        self._arguments = policy, make_evaluate, self._shared, threads
        self._child = self._start()
        self._pending: deque[tuple[int, np.ndarray]] = deque()
        self._completed: list[CompletedEvaluation] = []
        self._exits = 0

    def submit(self, step: int, values: np.ndarray) -> None:
        """As `InlineEvaluations.submit`, without waiting."""
        self._pending.append((step, values))
        if len(self._pending) == 1:
            self._send()

    def completed(self, *, timeout_s: float) -> list[CompletedEvaluation]:
        """As `InlineEvaluations.completed`."""
        self._read(timeout_s)
        completed, self._completed = self._completed, []
        return completed

    def pending(self) -> list[tuple[int, np.ndarray]]:
        """As `InlineEvaluations.pending`."""
        return list(self._pending)

    def close(self) -> None:
        """Kill the child process; what it evaluates now is lost."""
        self._child.stop(0.0)

    def _start(self) -> ChildProcess:
        return ChildProcess.start(self._context, "evaluator", run_evaluator, *self._arguments)

    def _read(self, timeout_s: float) -> None:
        """Take the results that are ready; wait for the first one for at most ``timeout_s``."""
        while self._pending and self._child.connection.poll(timeout_s):
            timeout_s = 0.0
            try:
                answer = self._child.connection.recv()
            except (EOFError, ConnectionResetError):
                self._restart(self._child.exit_reason())
                continue
            if isinstance(answer, ProcessFailure):
                if answer.user_error is not None:
                    raise answer.user_error
                self._restart(f"failed:\n{answer.traceback}")
                continue
            self._exits = 0
            step, values = self._pending.popleft()
            self._completed.append(CompletedEvaluation(step, values, answer))
            if self._pending:
                self._send()

    def _send(self) -> None:
        """Ask for the first pending evaluation."""
        self._shared["values"].copy_(torch.from_numpy(self._pending[0][1]))
        self._child.send(EvaluateShared())

    def _restart(self, reason: str) -> None:
        self._child.stop()
        self._exits += 1
        if self._exits >= MAX_EXITS:
            raise RuntimeError(
                f"The evaluator {reason}; {self._exits} times in a row. The last checkpoint is "
                "intact."
            )
        log.warning("The evaluator %s; restarting it.", reason)
        self.restarts += 1
        self._child = self._start()
        self._send()


Evaluations = InlineEvaluations | BackgroundEvaluations


def run_evaluator(
    policy: PolicySpec,
    make_evaluate: MakeEvaluate,
    shared: SharedTensors,
    threads: int | None,
    connection: Connection,
) -> None:
    """Entry point of the evaluator process: evaluate until the parent process exits."""
    prepare_child_process()
    if threads is not None:
        os.environ.update(limited_to(threads))
        torch.set_num_threads(threads)
    try:
        judge = policy.build()
        parameters = FlatParameters(judge)
        evaluate = make_evaluate()
        while True:
            connection.recv()
            parameters.values.copy_(shared["values"])
            connection.send(evaluate(judge))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        os._exit(0)
    except Exception as error:
        connection.send(ProcessFailure.of(error))
