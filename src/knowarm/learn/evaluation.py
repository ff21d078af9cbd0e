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
    values: np.ndarray
    """(P,) float32, the parameters of the evaluated policy; see `FlatParameters`."""
    results: Metrics


class Evaluations:
    """Runs interim evaluations, in the training process or in a child process.

    Args:
        policy: has the structure of the policies that are evaluated.
        make_evaluate: creates the function that evaluates; None evaluates nothing.
        in_background: evaluate in a child process while training continues; otherwise training
            waits where an evaluation is submitted.
        context: start method of the child process.
    """

    def __init__(
        self,
        policy: Policy,
        make_evaluate: MakeEvaluate | None,
        *,
        in_background: bool = False,
        context: BaseContext | None = None,
    ) -> None:
        self._pending: deque[tuple[int, np.ndarray]] = deque()
        self._completed: list[CompletedEvaluation] = []
        self._evaluate: Evaluate | None = None
        self.process: SupervisedProcess | None = None
        if make_evaluate is not None and in_background:
            context = context or process_context()
            # Parameters do not fit into a pipe: sending them would block while the child starts.
            parameters = sum(p.numel() for p in policy.parameters())
            specs = {"values": ((parameters,), torch.float32)}
            self._shared = SharedTensors(context, specs)
            arguments = (policy.maker(), make_evaluate, self._shared)
            self.process = SupervisedProcess(
                lambda restarts: ChildProcess.start(
                    context, "evaluator", run_evaluator, *arguments
                )
            )
        elif make_evaluate is not None:
            self._evaluate = make_evaluate()
            self._policy = policy.maker()()
            self._parameters = FlatParameters(self._policy)

    def submit(self, step: int, values: np.ndarray) -> None:
        """Evaluate the policy with the parameters ``values`` (P,)."""
        if self._evaluate is not None:
            self._parameters.values.copy_(torch.from_numpy(values))
            results = self._evaluate(self._policy)
            self._completed.append(CompletedEvaluation(step, values, results))
        elif self.process is not None:
            self._pending.append((step, values))
            if len(self._pending) == 1:
                self._send(self.process)

    def completed(self, *, timeout_s: float) -> list[CompletedEvaluation]:
        """Return the evaluations that completed since the last call, in order of submission.

        If one is pending, wait at most ``timeout_s`` for the next result.
        """
        completed = self._completed
        self._completed = []
        while self.process is not None and self._pending:
            answer = self.process.receive(timeout_s)
            if answer is None:
                break
            timeout_s = 0.0
            if not isinstance(answer, Restarted):
                step, values = self._pending.popleft()
                completed.append(CompletedEvaluation(step, values, answer))
            if self._pending:
                self._send(self.process)
        return completed

    def pending(self) -> list[tuple[int, np.ndarray]]:
        """Return step and parameters of the submitted evaluations without a result."""
        return list(self._pending)

    def close(self) -> None:
        """Kill the child process; what it evaluates now is lost."""
        if self.process is not None:
            self.process.child.stop(0.0)

    def _send(self, process: SupervisedProcess) -> None:
        """Ask for the first pending evaluation."""
        _, values = self._pending[0]
        self._shared["values"].copy_(torch.from_numpy(values))
        process.child.send("evaluate")


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
