"""Interim evaluations during training: in the training process or in a background process."""

from collections import deque
from collections.abc import Callable
from multiprocessing.connection import Connection
from multiprocessing.context import BaseContext
from typing import NamedTuple

import numpy as np
import torch

from knowarm.learn.parallel.processes import (
    ChildProcess,
    Restarted,
    SupervisedProcess,
    process_context,
)
from knowarm.learn.parallel.shared_tensors import FlatParameters, SharedTensors
from knowarm.policy import MakePolicy, Policy

Metrics = dict[str, float]
"""Values by name."""
Evaluate = Callable[[Policy], Metrics]
"""Plays fixed episodes with a policy; its ``return_mean`` determines the best policy."""
MakeEvaluate = Callable[[], Evaluate]
"""Creates the function that plays the fixed episodes; picklable."""

MAX_PENDING = 8
"""Evaluations that may be pending before training pauses for the evaluator."""


class CompletedEvaluation(NamedTuple):
    """Result of one interim evaluation."""

    step: int
    values: np.ndarray  # (P,) float32, the parameters of the evaluated policy; see `FlatParameters`
    results: Metrics


class InlineEvaluations:
    """Runs each evaluation, if there are any, when it is submitted, while training waits."""

    def __init__(self, policy: Policy, evaluate: Evaluate | None) -> None:
        self._evaluate = evaluate
        if evaluate is not None:
            self._policy = policy.maker()()
            self._parameters = FlatParameters(self._policy)
        self._completed: list[CompletedEvaluation] = []

    def submit(self, step: int, values: np.ndarray) -> None:
        """Evaluate the policy with the parameters ``values`` (P,)."""
        if self._evaluate is not None:
            self._parameters.values.copy_(torch.from_numpy(values))
            self._completed.append(CompletedEvaluation(step, values, self._evaluate(self._policy)))

    def completed(self, *, timeout_s: float) -> list[CompletedEvaluation]:
        """Return the evaluations that completed since the last call, in order of submission.

        If one is pending, wait at most ``timeout_s`` for the next result.
        """
        completed, self._completed = self._completed, []
        return completed

    def pending(self) -> list[tuple[int, np.ndarray]]:
        """Return step and parameters of the submitted evaluations without a result."""
        return []

    def close(self) -> None:
        """Release resources: none."""


class BackgroundEvaluations:
    """Runs evaluations in a child process while training continues."""

    def __init__(
        self, policy: Policy, make_evaluate: MakeEvaluate, context: BaseContext | None = None
    ) -> None:
        context = context or process_context()
        # Parameters do not fit into a pipe: sending them would block while the child starts.
        parameters = sum(p.numel() for p in policy.parameters())
        specs = {"values": ((parameters,), torch.float32)}
        self._shared = SharedTensors(context, specs)
        self._pending: deque[tuple[int, np.ndarray]] = deque()
        arguments = policy.maker(), make_evaluate, self._shared
        self.process = SupervisedProcess(
            lambda restarts: ChildProcess.start(context, "evaluator", run_evaluator, *arguments)
        )

    def submit(self, step: int, values: np.ndarray) -> None:
        """As `InlineEvaluations.submit`, without waiting."""
        self._pending.append((step, values))
        if len(self._pending) == 1:
            self._send()

    def completed(self, *, timeout_s: float) -> list[CompletedEvaluation]:
        """As `InlineEvaluations.completed`."""
        completed = []
        while self._pending and (answer := self.process.receive(timeout_s)) is not None:
            timeout_s = 0.0
            if not isinstance(answer, Restarted):
                completed.append(CompletedEvaluation(*self._pending.popleft(), answer))
            if self._pending:
                self._send()
        return completed

    def pending(self) -> list[tuple[int, np.ndarray]]:
        """As `InlineEvaluations.pending`."""
        return list(self._pending)

    def close(self) -> None:
        """Kill the child process; what it evaluates now is lost."""
        self.process.child.stop(0.0)

    def _send(self) -> None:
        """Ask for the first pending evaluation."""
        self._shared["values"].copy_(torch.from_numpy(self._pending[0][1]))
        self.process.child.send("evaluate")


Evaluations = InlineEvaluations | BackgroundEvaluations


def run_evaluator(
    make_policy: MakePolicy,
    make_evaluate: MakeEvaluate,
    shared: SharedTensors,
    connection: Connection,
) -> None:
    """Entry point of the evaluator process: evaluate until the parent process exits."""
    judge = make_policy()
    parameters = FlatParameters(judge)
    evaluate = make_evaluate()
    while True:
        connection.recv()
        parameters.values.copy_(shared["values"])
        connection.send(evaluate(judge))
