"""A function and its arguments go in; a watched child process with a pipe comes out."""

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import BaseContext
from typing import Any

import torch

from knowarm.learn.allocator import keep_freed_memory


def process_context(preload: Sequence[str] = ()) -> BaseContext:
    """Return the start method: a fork server where there is one, else fresh interpreters.

    A fork server imports PyTorch once for all workers, and, unlike a plain fork, has no threads
    that a child would lose.

    Args:
        preload: modules the server imports before the first fork.
    """
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(preload))
    return context


def prepare_process() -> None:
    """Settings of every child process: one thread, and Ctrl-C is the trainer's business."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    torch.set_num_threads(1)
    keep_freed_memory()


@dataclass
class Child:
    """One child process and the trainer's end of its pipe."""

    name: str
    process: Any
    connection: Connection

    @classmethod
    def start(
        cls, context: BaseContext, name: str, run: Callable[..., None], *arguments: Any
    ) -> "Child":
        """Start ``run(*arguments, connection)`` in a process of its own."""
        here, there = context.Pipe()
        process = context.Process(  # type: ignore[attr-defined]
            target=run, args=(*arguments, there), name=name, daemon=True
        )
        process.start()
        # The child holds the only other end now: when it dies, reading here ends.
        there.close()
        return cls(name, process, here)

    def send(self, message: Any) -> None:
        """Send a message; a dead child is noticed when reading."""
        try:
            self.connection.send(message)
        except (BrokenPipeError, ConnectionResetError):
            return

    def messages(self) -> Iterator[Any]:
        """Yield what has arrived; None at the end of a child that is gone."""
        try:
            while self.connection.poll(0):
                yield self.connection.recv()
        except (EOFError, ConnectionResetError, OSError):
            yield None

    def how_it_ended(self) -> str:
        """Say how a process that is gone has ended."""
        self.process.join(5)
        code = self.process.exitcode
        killed = code is not None and code < 0
        return f"was killed by signal {-code}" if killed else f"ended with exit code {code}"

    def end(self, patience_s: float = 5.0) -> None:
        """Close the pipe, which ends the child, and make sure of it."""
        self.connection.close()
        self.process.join(patience_s)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()


def wait_for(children: Sequence[Child], timeout_s: float) -> list[Child]:
    """Return the children that have sent something or have died, waiting at most so long."""
    ready = wait([child.connection for child in children], timeout_s)
    return [child for child in children if child.connection in ready]
