"""Child processes: start method, process-wide settings, pipes and failure reports."""

import atexit
import ctypes
import logging
import multiprocessing
import os
import shutil
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from multiprocessing.connection import Connection, wait
from multiprocessing.context import BaseContext
from pathlib import Path
from typing import Any

import psutil
import torch

from knowarm.errors import UserError
from knowarm.private_apis import keep_temporary_files_in, release_fork_server

log = logging.getLogger("knowarm.learn")

STOP_S = 3.0
"""Time that child processes have to exit after their pipes were closed; then they are killed."""

CHECK_S = 1.0
"""Time between two looks at whether a child process was stopped from outside."""

READY_S = 0.1
"""Time between two looks at whether training should stop, while the fork server starts [s]."""

START_ATTEMPTS = 8
"""How often the start of a child process is tried when its fork server is killed meanwhile."""

START_PAUSE_S = 0.05
"""Pause before the second attempt, doubled for each further one: a server that is being killed
refuses connections for a while before it counts as dead [s]."""

_FOLDER = "knowarm-"
"""Beginning of the names of `_temporary_folder`; the process id follows."""

_PR_SET_PDEATHSIG = 1
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
    keep_temporary_files_in(_temporary_folder())
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["knowarm.learn.fork_server", *preload])
    return context


def wait_for_fork_server(context: BaseContext, should_stop: Callable[[], bool]) -> bool:
    """Wait until child processes can be started, unless training is to stop before that.

    A new fork server imports PyTorch before it answers, which takes seconds, and on a busy machine
    many; `ChildProcess.start` would wait for it without looking at ``should_stop``.

    Returns:
        Whether training goes on; false if it was asked to stop meanwhile.
    """
    if context.get_start_method() != "forkserver":
        return not should_stop()
    is_ready = threading.Event()

    def start() -> None:
        process = context.Process(target=_do_nothing, daemon=True)  # type: ignore[attr-defined]
        with suppress(EOFError, OSError):  # `ChildProcess.start` replaces the server
            process.start()
            is_ready.set()
            process.join()
        is_ready.set()

    threading.Thread(target=start, name="fork server", daemon=True).start()
    while not should_stop():
        if is_ready.wait(READY_S):
            return not should_stop()
    return False


def _do_nothing() -> None:
    """Run in a child process that shows that its fork server works."""


@cache
def _temporary_folder() -> Path:
    """Return this process's folder for sockets and the like; remove those of killed processes.

    A process removes its own at its end. One that was killed leaves it to the next one.
    """
    parent = Path(tempfile.gettempdir())
    for old in parent.glob(f"{_FOLDER}*"):
        pid = old.name.removeprefix(_FOLDER).split("-")[0]
        if pid.isdigit() and not psutil.pid_exists(int(pid)):
            shutil.rmtree(old, ignore_errors=True)
    made = Path(tempfile.mkdtemp(prefix=f"{_FOLDER}{os.getpid()}-"))
    atexit.register(_remove, made, os.getpid())
    return made


def _remove(folder: Path, pid: int) -> None:
    if os.getpid() == pid:
        shutil.rmtree(folder, ignore_errors=True)


def prepare_child_process() -> None:
    """Set up a child process: one thread, freed memory kept, Ctrl-C left to the parent.

    A child ends when reading its pipe fails. One that was stopped (SIGSTOP) cannot notice it, so
    on Linux the kernel kills the children when the fork server exits, which it does as soon as the
    training process has ended.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "SIGHUP"):
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
    if sys.platform.startswith("linux"):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL))
        release_fork_server()
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


@dataclass(eq=False)
class ChildProcess:
    """A child process and the parent's end of its pipe.

    A child that is stopped from outside (SIGSTOP) would block its parent; it is continued.
    """

    name: str
    process: Any
    connection: Connection

    @classmethod
    def start(
        cls, context: BaseContext, name: str, run: Callable[..., None], *arguments: Any
    ) -> "ChildProcess":
        """Start ``run(*arguments, connection)`` in a new process.

        A fork server that is killed while it starts the process is replaced by a new one.
        """
        for attempt in range(START_ATTEMPTS):
            here, there = context.Pipe()
            process = context.Process(  # type: ignore[attr-defined]
                target=run, args=(*arguments, there), name=name, daemon=True
            )
            try:
                process.start()
                break
            except (EOFError, ConnectionError):
                here.close()  # a process that was started all the same exits
                if attempt == START_ATTEMPTS - 1:
                    raise
                log.warning("The fork server ended while starting the %s; trying again.", name)
                time.sleep(START_PAUSE_S * 2**attempt)
            finally:
                # The child has the only other end, so reading fails once it has exited.
                there.close()
        child = cls(name, process, here)
        _watch.add(child)
        return child

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


class _Watch:
    """Thread that continues child processes, and their fork server, when they were stopped."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._names: dict[psutil.Process, str] = {}
        self._thread: threading.Thread | None = None

    def add(self, child: ChildProcess) -> None:
        """Watch a child process until it ends."""
        try:
            process = psutil.Process(child.process.pid)
            server = process.parent()
        except psutil.Error:
            return  # it has ended already
        with self._lock:
            self._names[process] = child.name
            if server is not None and server.ppid() == os.getpid():
                self._names[server] = "fork server"
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="watch", daemon=True)
                self._thread.start()

    def _run(self) -> None:
        while True:
            time.sleep(CHECK_S)
            with self._lock:
                for process in list(self._names):
                    try:
                        if process.status() == psutil.STATUS_STOPPED:
                            log.warning("The %s was stopped; continuing it.", self._names[process])
                            process.resume()
                    except psutil.Error:
                        del self._names[process]
                if not self._names:
                    self._thread = None
                    return


_watch = _Watch()


def wait_for_messages(children: Sequence[ChildProcess], timeout_s: float) -> list[ChildProcess]:
    """Return the children that have sent a message or exited, after at most ``timeout_s``."""
    ready = wait([child.connection for child in children], timeout_s)
    return [child for child in children if child.connection in ready]
