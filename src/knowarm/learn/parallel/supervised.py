"""Supervised child processes: restarted when they exit, until they exit repeatedly."""

import logging
from collections.abc import Callable
from typing import Any

from knowarm.learn.parallel.processes import ChildProcess, ProcessFailure

log = logging.getLogger("knowarm.learn")

MAX_EXITS = 3
"""Consecutive exits of a process without a message between them after which training stops."""


class Restarted:
    """In place of a message: the process was restarted; it knows nothing of what it was sent."""


class SupervisedProcess:
    """A child process that is reported and restarted when it exits or raises an exception.

    Attributes:
        child: the running process; ``start`` starts one, given the number of former processes.
        restarts: number of former processes.
    """

    def __init__(self, start: Callable[[int], ChildProcess], restarts: int = 0) -> None:
        self._start = start
        self.restarts = restarts
        self.child = start(restarts)
        self._exits = 0

    def send(self, message: Any) -> None:
        """Send a message; `receive` notices if the process has exited."""
        self.child.send(message)

    def receive(self, timeout_s: float | None = None) -> Any:
        """Wait for the next message; return None after ``timeout_s``, `Restarted` after an exit.

        Raises:
            UserError: the process raised one; a restarted process would raise it as well.
            RuntimeError: the process exits or fails repeatedly.
        """
        try:
            if timeout_s is not None and not self.child.connection.poll(timeout_s):
                return None
            message = self.child.connection.recv()
        except (EOFError, OSError):
            return self._restart(self.child.exit_reason())
        if not isinstance(message, ProcessFailure):
            self._exits = 0
            return message
        if message.user_error is not None:
            raise message.user_error
        return self._restart(f"failed:\n{message.traceback}")

    def _restart(self, reason: str) -> Restarted:
        name = self.child.name
        self.child.stop()
        self._exits += 1
        if self._exits >= MAX_EXITS:
            raise RuntimeError(
                f"The {name} {reason}; {self._exits} times in a row. The last checkpoint is "
                'intact. A script that trains needs `if __name__ == "__main__":` around its code.'
            )
        log.warning("The %s %s; restarting it.", name, reason)
        self.restarts += 1
        self.child = self._start(self.restarts)
        return Restarted()
