"""Beginnings and ends of a piece of work go in; the seconds it took on its device come out."""

import time

import torch


class Stopwatch:
    """Adds up the time between `begin` and `end`, on a GPU by its own clock and without waiting.

    Args:
        device: where the work is done.
    """

    def __init__(self, device: torch.device) -> None:
        self._on_gpu = device.type == "cuda"
        self._seconds = 0.0
        self._begun = 0.0
        self._events: list[tuple[torch.cuda.Event, torch.cuda.Event]] = []

    def begin(self) -> None:
        """Begin a piece of work."""
        if self._on_gpu:
            pair = torch.cuda.Event(enable_timing=True), torch.cuda.Event(enable_timing=True)
            pair[0].record()
            self._events.append(pair)
        else:
            self._begun = time.perf_counter()

    def end(self) -> None:
        """End it."""
        if self._on_gpu:
            self._events[-1][1].record()
        else:
            self._seconds += time.perf_counter() - self._begun

    def seconds(self) -> float:
        """Return the time of all pieces so far [s]; waits for a GPU to have done the last."""
        for first, last in self._events:
            last.synchronize()
            self._seconds += first.elapsed_time(last) / 1000
        self._events = []
        return self._seconds
