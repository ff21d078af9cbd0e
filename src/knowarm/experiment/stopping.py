"""Ctrl-C goes in; a flag that the training asks between updates comes out."""

import signal
from types import FrameType
from typing import Any


class StopRequest:
    """Turns the first Ctrl-C (or SIGTERM) into a request to save and stop.

    A second one interrupts at once. Use it as a context manager in the main thread; called, it
    tells whether to stop.
    """

    def __init__(self) -> None:
        self._stop = False
        self._before: dict[signal.Signals, Any] = {}

    def __call__(self) -> bool:
        """Tell whether a stop was asked for."""
        return self._stop

    def __enter__(self) -> "StopRequest":
        """Take over the two signals."""
        for number in (signal.SIGINT, signal.SIGTERM):
            self._before[number] = signal.signal(number, self._ask)
        return self

    def __exit__(self, *exception: object) -> None:
        """Give the signals back."""
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _ask(self, number: int, frame: FrameType | None) -> None:
        if self._stop:
            raise KeyboardInterrupt
        self._stop = True
