"""Request to stop a training, made by a signal."""

import signal
from types import FrameType
from typing import Any


class StopRequest:
    """Signal handler that turns the first Ctrl-C (or SIGTERM) into a request to save and stop.

    A second one raises KeyboardInterrupt. A terminal that closes (SIGHUP, sent once or several
    times) requests to save and stop, too. Use it as a context manager in the main thread and pass
    it as ``should_stop``: calling it returns whether a signal arrived.
    """

    def __init__(self) -> None:
        self._stop = False
        self._previous: dict[signal.Signals, Any] = {}

    def __call__(self) -> bool:
        """Return whether a stop was requested."""
        return self._stop

    def __enter__(self) -> "StopRequest":
        """Install the handlers."""
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)
            if number is None:
                continue  # Windows has no SIGHUP
            if name == "SIGHUP" and signal.getsignal(number) is signal.SIG_IGN:
                continue  # nohup
            self._previous[number] = signal.signal(number, self._on_signal)
        return self

    def __exit__(self, *exception: object) -> None:
        """Restore the previous handlers."""
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if self._stop and number in (signal.SIGINT, signal.SIGTERM):
            raise KeyboardInterrupt
        self._stop = True
