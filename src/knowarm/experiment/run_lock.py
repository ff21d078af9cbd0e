"""Lock of a folder: one process at a time writes into it, until it is asked to stop."""

import os
import signal
import socket
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from types import FrameType
from typing import Any

import psutil
from filelock import FileLock, Timeout

from knowarm.errors import UserError
from knowarm.reading import read_json, refuse_links, write_json, writing

LOCK = ".lock"
"""File that the kernel locks; it outlives the process."""
HOLDER = ".lock.json"
"""File that names the holder of the lock; it outlives a process that is killed."""
SECONDS = 1.0
"""How long to wait for the lock: `is_locked` holds it for a moment."""
CLOCK_S = 2.0
"""How much the start of a process may seem to change when the clock is set."""


class FolderInUseError(UserError):
    """Another process holds the lock of a folder."""


class FolderLock:
    """Lock of a folder that this process holds; see `lock_folder`."""

    def __init__(self, path: Path, remedy: str) -> None:
        self._path = path
        self._remedy = remedy
        self._folder = _inode(path)
        self._acquire(SECONDS)
        self._holder = {
            "pid": os.getpid(),
            "host": socket.gethostname(),
            "since": datetime.now(UTC).isoformat(timespec="seconds"),
            "started": psutil.Process().create_time(),
        }
        try:
            holder = _live_holder(path)
            if holder:
                raise self._in_use(holder)
            write_json(path / HOLDER, self._holder)
        except UserError:
            self._lock.release()
            raise

    def check(self) -> None:
        """Make sure that the folder is still this process's; restore lock files that are gone.

        Raises:
            FolderInUseError: another process has taken it.
            UserError: the folder was moved or removed, whatever is at its path now.
        """
        with writing(self._path / LOCK, self._remedy):
            if _inode(self._path) != self._folder:
                raise OSError("the folder was moved or removed")
            if _inode(self._path / LOCK) != self._inode:
                self._lock.release()
                self._acquire(0.0)
        holder = _read_holder(self._path)
        if not holder:
            write_json(self._path / HOLDER, self._holder)
        elif holder != self._holder:
            raise self._in_use(_name(holder))

    def release(self) -> None:
        """Release the lock."""
        if _read_holder(self._path) == self._holder:
            (self._path / HOLDER).unlink(missing_ok=True)
        self._lock.release()

    def _acquire(self, seconds: float) -> None:
        self._lock = FileLock(self._path / LOCK, timeout=seconds)
        try:
            self._lock.acquire()
            self._inode = _inode(self._path / LOCK)
        except Timeout as error:
            raise self._in_use(_name(_read_holder(self._path))) from error

    def _in_use(self, holder: str) -> FolderInUseError:
        return FolderInUseError(f"{self._path} is in use by {holder}. {self._remedy}")


def is_locked(path: Path) -> bool:
    """Return whether a live process holds the lock of a folder."""
    if _live_holder(path):
        return True
    if not (path / LOCK).is_file():
        return False
    lock = FileLock(path / LOCK, timeout=0)
    try:
        with lock:
            return False
    except OSError as error:  # another one: a read-only folder
        return isinstance(error, Timeout)


@contextmanager
def lock_folder(path: Path, *, remedy: str) -> Iterator[FolderLock]:
    """Hold the lock of a folder, which is created if missing; the error ends with the remedy.

    The kernel releases the lock when the process ends, however it ends; children do not inherit it.
    Where the lock file was removed, or a network file system locks nothing, a live process of this
    machine that ``.lock.json`` names holds the folder as well.
    """
    with writing(path, "Pass another folder, or change its permissions."):
        path.mkdir(parents=True, exist_ok=True)
        refuse_links(path)
        lock = FolderLock(path, remedy)
    try:
        yield lock
    finally:
        lock.release()


def _inode(file: Path) -> tuple[int, int] | None:
    """Return what tells a file or folder from another one of its name; None if there is none."""
    try:
        state = file.stat()
    except OSError:
        return None
    return state.st_dev, state.st_ino


def _read_holder(path: Path) -> dict[str, Any]:
    """Read what ``.lock.json`` says; nothing if it is missing or damaged."""
    try:
        return read_json(path / HOLDER)
    except UserError:
        return {}


def _live_holder(path: Path) -> str:
    """Name the process of this machine that holds a folder, and still runs."""
    holder = _read_holder(path)
    if holder.get("host") != socket.gethostname():
        return ""
    try:
        started = psutil.Process(int(holder["pid"])).create_time()
        is_same = abs(started - holder["started"]) < CLOCK_S
    except (psutil.Error, KeyError, TypeError, ValueError, OverflowError):
        return ""
    return _name(holder) if is_same else ""


def _name(holder: Mapping[str, Any]) -> str:
    """Describe the process that holds a lock, as far as it is known."""
    try:
        return f"process {holder['pid']} on {holder['host']} since {holder['since']}"
    except KeyError:
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
