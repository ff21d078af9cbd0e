"""Lock of a folder: one process at a time writes into it, until it is asked to stop."""

import json
import os
import signal
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from types import FrameType
from typing import Any

from filelock import FileLock, Timeout

from knowarm.errors import UserError
from knowarm.reading import refuse_links, write_json

LOCK = ".lock"
"""File that the kernel locks; it outlives the process."""
HOLDER = ".lock.json"
"""File that names the holder of the lock; it outlives the process."""
SECONDS = 1.0
"""How long to wait for the lock: `is_locked` holds it for a moment."""


class FolderInUseError(UserError):
    """Another process holds the lock of a folder."""


def is_locked(path: Path) -> bool:
    """Return whether a live process holds the lock of a folder."""
    if not (path / LOCK).exists():
        return False
    lock = FileLock(path / LOCK, timeout=0)
    try:
        with lock:
            return False
    except OSError as error:  # another one: a read-only folder
        return isinstance(error, Timeout)


@contextmanager
def lock_folder(path: Path, *, remedy: str) -> Iterator[None]:
    """Hold the lock of a folder, which is created if missing; the error ends with the remedy.

    The kernel releases the lock when the process ends, however it ends; children do not inherit it.
    """
    lock = FileLock(path / LOCK, timeout=SECONDS)
    try:
        path.mkdir(parents=True, exist_ok=True)
        refuse_links(path)
        lock.acquire()
    except Timeout as error:
        raise FolderInUseError(
            f"{path} is in use by {_holder(path)}. {remedy}"
        ) from error
    except OSError as error:
        raise UserError(
            f"Cannot write to the output folder {path}: {error.strerror or error}. Pass "
            "another folder, or change its permissions."
        ) from error
    since = datetime.now(UTC).isoformat(timespec="seconds")
    try:
        holder = {"pid": os.getpid(), "host": socket.gethostname(), "since": since}
        write_json(path / HOLDER, holder)
        yield
    finally:
        lock.release()


def _holder(path: Path) -> str:
    """Describe the process that holds the lock, as far as it is known."""
    try:
        holder = json.loads((path / HOLDER).read_text(encoding="utf-8"))
        return f"process {holder['pid']} on {holder['host']} since {holder['since']}"
    except (OSError, ValueError, KeyError, TypeError):
        return "another process"


class StopRequest:
    """Context manager in which the first Ctrl-C or SIGTERM requests to save and stop.

    A second Ctrl-C raises KeyboardInterrupt. A terminal that closes (SIGHUP) requests to stop, too.
    Pass it as ``should_stop``: calling it returns whether a signal arrived.
    """

    def __init__(self) -> None:
        self._stop = False
        self._previous: dict[signal.Signals, Any] = {}

    def __call__(self) -> bool:
        """Return whether a stop was requested."""
        return self._stop

    def __enter__(self) -> "StopRequest":
        """Install the handlers."""
        numbers = [signal.SIGINT, signal.SIGTERM]
        # Windows has none, and nohup ignores it
        hangup = getattr(signal, "SIGHUP", None)
        if hangup is not None and signal.getsignal(hangup) is not signal.SIG_IGN:
            numbers.append(hangup)
        for number in numbers:
            self._previous[number] = signal.signal(number, self._on_signal)
        return self

    def __exit__(self, *exception: object) -> None:
        """Restore the previous handlers."""
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if self._stop and number == signal.SIGINT:
            raise KeyboardInterrupt
        self._stop = True
