"""Child processes: start method, process-wide settings, pipes and failure reports."""

import ctypes
import multiprocessing
import signal
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import BaseContext
from typing import Any

import torch

from knowarm.errors import UserError

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
_KEEP_BYTES = 1 << 30


def keep_freed_memory() -> bool:
    """Make the C library keep up to 1 GiB of freed memory for this process.

    A gradient step allocates tensors of tens of megabytes, frees them, and allocates them again.
    By default glibc maps such blocks afresh every time and the kernel zeroes their pages, which
    takes a third of an update's time on two cores (docs/learning.md). The setting applies to
    the entire process; `PPOTrainer.train` and the child processes change it.

    Returns:
        Whether the setting took effect; only glibc has it.
    """
    if not sys.platform.startswith("linux"):
        return False
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is None:
        return False
    return bool(mallopt(_M_MMAP_THRESHOLD, _KEEP_BYTES)) and bool(
        mallopt(_M_TRIM_THRESHOLD, 2 * _KEEP_BYTES - 1)
    )


def process_context(preload: Sequence[str] = ()) -> BaseContext:
    """Return the start method of child processes: fork server where available, else spawn.

    A fork server imports PyTorch once for all children and, unlike fork, has no threads that a
    child would lose.

    Args:
        preload: modules that the server imports before the first fork.
    """
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(preload))
    return context


def prepare_child_process() -> None:
    """Set up a child process: one thread, freed memory kept, Ctrl-C left to the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    torch.set_num_threads(1)
    keep_freed_memory()


@dataclass(frozen=True)
class ProcessFailure:
    """Message of a child process that raised an exception and exits."""

    traceback: str
    user_error: UserError | None
    """The exception, if it is a `UserError`."""

    @classmethod
    def of(cls, error: Exception) -> "ProcessFailure":
        """Describe an exception."""
        lines = traceback.format_exception(error)
        return cls("".join(lines), error if isinstance(error, UserError) else None)

    @property
    def summary(self) -> str:
        """Last line of the traceback."""
        return self.traceback.strip().splitlines()[-1]


@dataclass
class ChildProcess:
    """A child process and the parent's end of its pipe."""

    name: str
    process: Any
    connection: Connection

    @classmethod
    def start(
        cls, context: BaseContext, name: str, run: Callable[..., None], *arguments: Any
    ) -> "ChildProcess":
        """Start ``run(*arguments, connection)`` in a new process."""
        here, there = context.Pipe()
        process = context.Process(  # type: ignore[attr-defined]
            target=run, args=(*arguments, there), name=name, daemon=True
        )
        process.start()
        # The child now has the only other end, so reading fails once it has exited.
        there.close()
        return cls(name, process, here)

    def send(self, message: Any) -> None:
        """Send a message; the exit of the child is noticed when reading."""
        try:
            self.connection.send(message)
        except (BrokenPipeError, ConnectionResetError):
            return

    def messages(self) -> Iterator[Any]:
        """Yield the messages that have arrived, and None if the child has exited."""
        try:
            while self.connection.poll(0):
                yield self.connection.recv()
        except (EOFError, ConnectionResetError, OSError):
            yield None

    def exit_reason(self) -> str:
        """Describe how a child that has exited did so."""
        self.process.join(5)
        code = self.process.exitcode
        killed = code is not None and code < 0
        return f"was killed by signal {-code}" if killed else f"ended with exit code {code}"

    def stop(self, timeout_s: float = 5.0) -> None:
        """Close the pipe, upon which the child exits; kill it after the timeout."""
        self.connection.close()
        self.process.join(timeout_s)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()


def wait_for_messages(children: Sequence[ChildProcess], timeout_s: float) -> list[ChildProcess]:
    """Return the children that have sent a message or exited, after at most ``timeout_s``."""
    ready = wait([child.connection for child in children], timeout_s)
    return [child for child in children if child.connection in ready]
