"""Request to stop a training, made by a signal."""

import signal
from types import FrameType
from typing import Any


class StopRequest:
    """Context manager in which the first Ctrl-C or SIGTERM requests to save and stop.

    A second one raises KeyboardInterrupt. A terminal that closes (SIGHUP) requests to stop, too.
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
        hangup = getattr(signal, "SIGHUP", None)  # Windows has none, and nohup ignores it
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
        if self._stop and number in (signal.SIGINT, signal.SIGTERM):
            raise KeyboardInterrupt
        self._stop = True
