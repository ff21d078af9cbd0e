"""A policy goes in whenever an interim evaluation is due; results come out, now or later."""

from collections import deque
from dataclasses import dataclass
from typing import Protocol

import torch

from knowarm.learn.checkpoint import Arrays, policy_arrays
from knowarm.learn.evaluator import Evaluation, MakeEvaluate, Snapshot, run_evaluator
from knowarm.learn.flat import FlatParameters
from knowarm.learn.processes import Child, process_context
from knowarm.learn.trainer import Evaluate, Metrics
from knowarm.policy import Policy

MOST_WAITING = 8
"""Snapshots that may wait for the evaluator before training waits for it."""


@dataclass(frozen=True)
class Finished:
    """One interim evaluation."""

    step: int
    policy: Arrays
    """The parameters that were judged, by name."""
    results: Metrics


class Evaluations(Protocol):
    """Where interim evaluations are played."""

    def ask(self, step: int, policy: Policy) -> None:
        """Have the policy judged as it is now."""
        ...

    def finished(self, *, wait: bool) -> list[Finished]:
        """Return what was not returned before, in the order it was asked for.

        Args:
            wait: until everything that was asked for is there.
        """
        ...

    def end(self) -> None:
        """Free what is held."""
        ...


class InlineEvaluations:
    """Plays evaluations at once, while training waits.

    Args:
        evaluate: plays the fixed episodes.
    """

    def __init__(self, evaluate: Evaluate) -> None:
        self._evaluate = evaluate
        self._done: list[Finished] = []

    def ask(self, step: int, policy: Policy) -> None:
        """As `Evaluations.ask`."""
        results = self._evaluate(policy)
        self._done.append(Finished(step, policy_arrays(policy), results))

    def finished(self, *, wait: bool) -> list[Finished]:
        """As `Evaluations.finished`."""
        done, self._done = self._done, []
        return done

    def end(self) -> None:
        """Nothing is held."""


class BackgroundEvaluations:
    """Plays evaluations in a process of its own, while training goes on.

    Args:
        policy: gives the network its sizes.
        make_evaluate: makes, in the process, what plays the fixed episodes; picklable.
    """

    def __init__(self, policy: Policy, make_evaluate: MakeEvaluate) -> None:
        context = process_context(["knowarm.learn.evaluator"])
        self._config = policy.config
        self._child = Child.start(context, "evaluator", run_evaluator, policy.config, make_evaluate)
        self._waiting: deque[Snapshot] = deque()
        self._asked = 0
        self._done: list[Finished] = []

    def ask(self, step: int, policy: Policy) -> None:
        """As `Evaluations.ask`; waits only if the evaluator is far behind."""
        values = torch.cat([p.detach().flatten() for p in policy.parameters()]).cpu().numpy()
        self._asked += 1
        self._waiting.append(Snapshot(number=self._asked, step=step, values=values))
        # One at a time: the pipe is small and sending to a busy process would wait for it.
        if len(self._waiting) == 1:
            self._child.send(self._waiting[0])
        self._read(leave=MOST_WAITING)

    def finished(self, *, wait: bool) -> list[Finished]:
        """As `Evaluations.finished`."""
        self._read(leave=0 if wait else len(self._waiting))
        done, self._done = self._done, []
        return done

    def end(self) -> None:
        """End the process."""
        self._child.end()

    def _read(self, leave: int) -> None:
        """Take results until at most ``leave`` snapshots wait, and what has come beyond these."""
        while self._waiting and (len(self._waiting) > leave or self._child.connection.poll(0)):
            try:
                answer: Evaluation = self._child.connection.recv()
            except (EOFError, ConnectionResetError):
                raise RuntimeError(
                    f"The evaluator {self._child.how_it_ended()}; the last checkpoint is whole."
                ) from None
            snapshot = self._waiting.popleft()
            assert answer.number == snapshot.number
            judged = Policy(self._config)
            FlatParameters(judged).values.copy_(torch.from_numpy(snapshot.values))
            self._done.append(Finished(snapshot.step, policy_arrays(judged), answer.results))
            if self._waiting:
                self._child.send(self._waiting[0])
