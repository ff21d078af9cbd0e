"""Child processes: start method, settings, pipes, failure reports, supervision."""

import ctypes
import logging
import multiprocessing
import pickle
import signal
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.context import BaseContext
from types import ModuleType
from typing import Any, NamedTuple

import torch

from knowarm.errors import UserError

STOP_S = 3.0
"""Time that child processes have to exit after their pipes were closed; then they are killed."""

START_S = 10.0
"""Time that a fork server which is killed while it starts a child process has to be replaced.

The kernel closes the socket of a killed process before it reports the exit: until then, connections
are refused, and no new server is started.
"""

# Options of mallopt, from malloc.h.
_M_TRIM_THRESHOLD = -1
_M_MMAP_THRESHOLD = -3
_KEEP_BYTES = 1 << 30


def keep_freed_memory() -> None:
    """Make the C library (glibc only) keep up to 1 GiB of freed memory for this process.

    A gradient step allocates and frees tensors of tens of megabytes. By default glibc maps such
    blocks afresh every time and the kernel zeroes their pages, which takes a third of an update's
    time on two cores (docs/lab-notes.md). `PPOTrainer.train` and child processes set this.
    """
    if not sys.platform.startswith("linux"):
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_MMAP_THRESHOLD, _KEEP_BYTES)
        mallopt(_M_TRIM_THRESHOLD, 2 * _KEEP_BYTES - 1)


def process_context(*preload: str) -> BaseContext:
    """Return the start method of child processes: fork server where available, else spawn.

    A fork server imports PyTorch, and the modules ``preload``, once for all children and, unlike
    fork, has no threads that a child would lose.
    """
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(
        ["knowarm.learn.parallel.fork_server", __name__, *preload]
    )
    return context


def _run_child(
    run: Callable[..., None],
    arguments: tuple[Any, ...],
    connection: Connection,
) -> None:
    # Signals are left to the parent process
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "SIGHUP"):
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
    torch.set_num_threads(1)
    keep_freed_memory()
    try:
        run(*arguments, connection)
    except Exception as error:
        user_error = error if isinstance(error, UserError) else None
        with suppress(BrokenPipeError, ConnectionResetError):
            connection.send(ProcessFailure(traceback.format_exc(), user_error))


def _start(process: Any) -> None:
    """Start a process that does not run the user's script again, as multiprocessing would.

    A script without `if __name__ == "__main__":` would train once more in every child process. Only
    what a script itself defines and hands to a child process, such as a task, needs the script.
    """
    script = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        process.start()
        return
    except (AttributeError, pickle.PicklingError):
        pass  # something that the script defines
    finally:
        sys.modules["__main__"] = script
    process.start()


class ProcessFailure(NamedTuple):
    """Message of a child process that raised an exception and exits."""

    traceback: str
    user_error: UserError | None
    """The exception, if it is a `UserError`."""


@dataclass(eq=False)
class ChildProcess:
    """A child process and the parent's end of its pipe."""

    name: str
    process: Any
    connection: Connection

    @classmethod
    def start(
        cls,
        context: BaseContext,
        name: str,
        run: Callable[..., None],
        *arguments: Any,
    ) -> "ChildProcess":
        """Start ``run(*arguments, connection)`` in a new process.

        An exception in it is sent as a `ProcessFailure`, unless the parent process has exited.
        A fork server that is killed while it starts the process is replaced by a new one.
        """
        deadline = time.monotonic() + START_S
        while True:
            here, there = context.Pipe()
            process = context.Process(  # type: ignore[attr-defined]
                target=_run_child, args=(run, arguments, there), name=name, daemon=True
            )
            try:
                _start(process)
                return cls(name, process, here)
            except (EOFError, ConnectionError):
                here.close()  # a process that was started all the same exits
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.05)
            finally:
                # The child has the only other end, so reading fails once it has exited.
                there.close()

    def send(self, message: Any) -> None:
        """Send a message; the exit of the child is noticed when reading."""
        with suppress(BrokenPipeError, ConnectionResetError):
            self.connection.send(message)

    def exit_reason(self) -> str:
        """Describe how a child that has exited did so."""
        self.process.join(5)
        code = self.process.exitcode
        if code is not None and code < 0:
            return f"was killed by signal {-code}"
        return f"ended with exit code {code}"

    def stop(self, timeout_s: float = STOP_S) -> None:
        """Close the pipe, upon which the child exits; kill it after the timeout."""
        self.connection.close()
        self.process.join(timeout_s)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()


def stop_all(children: Sequence[ChildProcess], timeout_s: float = STOP_S) -> None:
    """Stop child processes that all have the same ``timeout_s`` to exit."""
    for child in children:
        child.connection.close()
    deadline = time.monotonic() + timeout_s
    for child in children:
        child.stop(max(0.0, deadline - time.monotonic()))


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
                "intact. A script that defines a task or an agent itself needs "
                '`if __name__ == "__main__":` around the lines that train.'
            )
        log.warning("The %s %s; restarting it.", name, reason)
        self.restarts += 1
        self.child = self._start(self.restarts)
        return Restarted()
