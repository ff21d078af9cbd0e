"""Ways to start processes go in; their messages come out, the dead replaced on the way."""

import logging
from collections.abc import Callable, Iterator
from typing import Any

from knowarm.errors import UserError
from knowarm.learn.a3c.messages import Failure, Record, Restarted
from knowarm.learn.guards import NotFiniteError
from knowarm.learn.processes import Child, wait_for

log = logging.getLogger("knowarm.learn")

GIVE_UP_AFTER = 3
"""A process that ends so often without having done anything is not started again."""


class Crew:
    """The worker processes and the evaluator.

    Args:
        start_worker: starts worker ``index`` in its ``life``-th process.
        start_evaluator: starts the evaluator; None for none.
        lives: how many processes each worker has used up so far; updated here.
    """

    def __init__(
        self,
        start_worker: Callable[[int, int], Child],
        start_evaluator: Callable[[], Child] | None,
        lives: list[int],
    ) -> None:
        self._start_worker = start_worker
        self._start_evaluator = start_evaluator
        self.lives = lives
        self.workers = [start_worker(index, life) for index, life in enumerate(lives)]
        self.evaluator = start_evaluator() if start_evaluator else None
        self._dismissed: set[int] = set()
        self._idle_deaths: dict[str, int] = {}

    def dismiss(self, index: int) -> None:
        """Expect worker ``index`` to end: it was told to."""
        self._dismissed.add(index)

    def read(self, timeout_s: float) -> Iterator[tuple[int | None, Any]]:
        """Yield what arrived as (worker index, or None for the evaluator; message).

        A process that died is started again, and a `Restarted` takes the place of its messages.

        Raises:
            NotFiniteError, UserError: a worker met one; the others would meet it too.
            RuntimeError: a process ends again and again.
        """
        watched: dict[int | None, Child] = {
            index: child for index, child in enumerate(self.workers) if index not in self._dismissed
        }
        if self.evaluator is not None:
            watched[None] = self.evaluator
        ready = wait_for(list(watched.values()), timeout_s)
        for index, child in watched.items():
            if child not in ready:
                continue
            for message in child.messages():
                if isinstance(message, Failure):
                    self._report(child, message)
                elif message is not None:
                    if isinstance(message, Record):
                        self._idle_deaths.pop(child.name, None)
                    yield index, message
                elif index not in self._dismissed:
                    yield index, self._replace(index, child)

    def end(self) -> None:
        """End all processes."""
        for child in [*self.workers, *([self.evaluator] if self.evaluator else [])]:
            child.end()

    def _report(self, child: Child, failure: Failure) -> None:
        """A child says why it ends; stop everything if the others would meet the same."""
        if failure.not_finite is not None:
            raise NotFiniteError(*failure.not_finite)
        if failure.user_error is not None:
            raise UserError(failure.user_error)
        if self._idle_deaths.get(child.name, 0) + 1 >= GIVE_UP_AFTER:
            raise RuntimeError(f"The {child.name} fails again and again.\n{failure.traceback}")
        log.warning("The %s failed: %s", child.name, failure.error)

    def _replace(self, index: int | None, child: Child) -> Restarted:
        self._idle_deaths[child.name] = self._idle_deaths.get(child.name, 0) + 1
        ending = child.how_it_ended()
        child.end()
        if self._idle_deaths[child.name] >= GIVE_UP_AFTER:
            raise RuntimeError(f"The {child.name} {ending}, again and again.")
        log.warning("The %s %s; another takes its place.", child.name, ending)
        if index is None:
            assert self._start_evaluator is not None
            self.evaluator = self._start_evaluator()
        else:
            self.lives[index] += 1
            self.workers[index] = self._start_worker(index, self.lives[index])
        return Restarted()
