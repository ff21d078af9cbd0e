"""Fence: a forked process with limits, in which what a stranger wrote is parsed or computed.

A file that nests deep enough overflows the stack of a parser in C or Rust, another one lets it
compute for ever or fill the memory. In a process of its own, each is an error in one line. A fork
takes milliseconds, and shares the modules and graphs of this process. Windows cannot fork: there,
nothing limits what is computed, which a warning says.
"""

import gc
import math
import os
import signal
import time
from collections.abc import Callable
from contextlib import closing, suppress
from functools import cache, partial
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from threading import BoundedSemaphore
from typing import Any, NoReturn, TypeVar

from knowarm.errors import UserError, warn
from knowarm.private_apis import unlock_cached_properties

SECONDS = 60.0
"""Processor time of a call, and of any further megabyte of its input [s]."""
WAIT = 5.0
"""Longest time that a call takes on a machine that others use, in processor times."""
LOOK = 0.25
"""Time between two looks at what a call does [s]."""
IDLE = 5
"""Looks between which no thread runs: they wait for a FIFO or device that a file names."""
MEMORY = 2 * 2**30
"""Memory beyond that of this process [bytes], beside 200 times the size of the input."""
STACK = 4 * 2**20
"""Stack [bytes]: smaller than that of this process, which may read again what a fence has read."""
_ROOM = BoundedSemaphore(4)
"""As many processes compute at a time, or strangers could fill the memory by many questions."""

T = TypeVar("T")


class ParserError(ValueError):
    """What is fenced raises an exception that is no `UserError`; the message is its own."""


class Fence:
    """Calls a function in a process with limits, which starts at the first call and is kept.

    Args:
        function: of arguments that can be pickled, as what it returns.
        size: of its input [bytes], which limits its time and memory.
        opens: whether it may open files and connections.
    """

    is_inside = False
    """Whether this process is fenced itself, or cannot be: functions are called in it."""

    def __init__(
        self, function: Callable[..., Any], *, size: int = 0, opens: bool = True
    ) -> None:
        self._function = function
        self._opens = opens
        self._seconds = math.ceil(SECONDS * (1 + size / 2**20))
        self._memory = MEMORY + 200 * size
        self._process = 0

    def __call__(self, *arguments: Any) -> Any:
        """Call the function.

        Raises:
            UserError: as the function does.
            ParserError: it raises any other exception.
            ValueError: it crosses a limit; the process is a new one at the next call.
        """
        if not hasattr(os, "fork"):
            Fence.is_inside = True
            _warn_of_no_limits()
        if Fence.is_inside:
            value, error = _outcome(self._function, arguments)
        else:
            value, error = self._ask(arguments)
        if error is not None:
            raise error
        return value

    def close(self) -> str:
        """End the process; return how it ended."""
        if not self._process or Fence.is_inside:  # which is a fork of the one that asks
            return ""
        os.kill(self._process, signal.SIGKILL)  # of one that has ended: without effect
        _, status = os.waitpid(self._process, 0)
        self._process = 0
        self._pipe.close()
        code = os.waitstatus_to_exitcode(status)
        return signal.Signals(-code).name if code < 0 else f"exit code {code}"

    def __del__(self) -> None:
        self.close()

    def _ask(self, arguments: Any) -> Any:
        """Return the outcome of the function in its process."""
        if not self._process:
            self._start()
        try:
            self._pipe.send(arguments)
            problem = self._wait()
            if not problem:
                return self._pipe.recv()
        except (EOFError, ConnectionError):
            limits = f"{self._seconds} s or {self._memory / 2**30:.1f} GiB"
            raise ValueError(
                f"it nests too deep, or needs more than {limits} ({self.close()})"
            ) from None
        except BaseException:
            self.close()
            raise
        self.close()
        raise ValueError(problem)

    def _wait(self) -> str:
        """Wait until the process answers or has ended; say why it is waited for no longer."""
        seconds = WAIT * self._seconds
        idle = 0
        before = ""
        end = time.monotonic() + seconds  # looks take longer on a busy machine
        while time.monotonic() < end:
            if self._pipe.poll(LOOK):
                return ""
            now = _waiting(self._process)
            idle += 1
            if not now or now != before:
                idle = 0
            before = now
            if idle == IDLE:
                return "it waits for a FIFO, a device or another program"
        return f"it takes more than {seconds:.0f} s"

    def _start(self) -> None:
        self._pipe, there = Pipe()
        self._process = os.fork()
        if not self._process:
            self._pipe.close()
            self._serve(there)
        there.close()

    def _serve(self, pipe: Connection) -> NoReturn:
        """Answer calls until the other process ends, or one of them crosses a limit."""
        try:
            Fence.is_inside = True
            # Finalizers of what is inherited may wait for threads, which a fork lacks.
            gc.freeze()
            unlock_cached_properties()
            _set_limits(self._memory)
            if not self._opens:
                _limit("NOFILE", 0)  # but for what is open
            while True:
                arguments = pipe.recv()
                _limit("CPU", math.ceil(time.process_time()) + self._seconds)
                pipe.send(_outcome(self._function, arguments))
        finally:
            os._exit(1)


def fenced(
    function: Callable[..., T], *arguments: Any, size: int = 0, opens: bool = True
) -> T:
    """Call a function once in a process with limits; see `Fence`."""
    fence = Fence(partial(function, *arguments), size=size, opens=opens)
    if Fence.is_inside:
        return fence()
    with _ROOM, closing(fence):
        return fence()


def _waiting(process: int) -> str:
    """Return what Linux counts of a process whose threads all wait, and not for a disk; else "".

    It changes whenever one of them runs, be it for a piece of a file from a slow network.
    """
    with suppress(OSError):  # one of them has ended
        files = Path(f"/proc/{process}/task").glob("*/status")
        threads = list(map(Path.read_text, files))
        if all("State:\tS" in thread for thread in threads):
            return "".join(threads)
    return ""


@cache
def _warn_of_no_limits() -> None:
    warn(
        "Windows limits neither time nor memory of what is parsed: a file of a stranger may crash "
        "this process, or keep it busy for ever. Open files that you trust alone."
    )


def _outcome(
    function: Callable[..., Any], arguments: Any
) -> tuple[Any, ValueError | None]:
    """Return what a function returns, and what it raises."""
    try:
        return function(*arguments), None
    except UserError as error:
        return None, error
    except MemoryError:
        raise
    except Exception as error:
        return None, ParserError(str(error) or type(error).__name__)


def _set_limits(memory: int) -> None:
    """Limit memory and stack of this process, which the other one alone ends and reads."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    null = os.open(os.devnull, os.O_RDWR)
    for stream in (1, 2):  # parsers that end the process say so there
        os.dup2(null, stream)
    _limit("CORE", 0)
    _limit("STACK", STACK)
    state = Path("/proc/self/statm")
    if state.exists():  # Linux
        pages = int(state.read_bytes().split()[0])
        _limit("AS", pages * os.sysconf("SC_PAGE_SIZE") + memory)


def _limit(kind: str, most: int) -> None:
    """Set a limit of this process, below that of the system."""
    import resource  # which Windows lacks

    number = getattr(resource, f"RLIMIT_{kind}")
    _, hard = resource.getrlimit(number)
    if hard >= 0:
        most = min(most, hard)
    resource.setrlimit(number, (most, hard))
