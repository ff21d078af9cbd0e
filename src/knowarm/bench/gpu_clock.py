"""Functions that launch work on a device go in; how long that work takes comes out."""

import math
import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import torch


def synchronize(device: torch.device) -> None:
    """Wait until a device has done all that was launched; the CPU always has."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def seconds_per_call(run: Callable[[], Any], seconds: float, device: torch.device) -> float:
    """Time a call of ``run`` by the host's clock, the device synchronised before and after.

    Calls are counted ahead, and more are made until a run of them is long enough: in between
    nothing waits for the device.

    Args:
        run: what is timed; called before, so that nothing compiles any more.
        seconds: how long the counted run of calls takes at least [s].
        device: where the work is done.
    """
    calls = 1
    while True:
        synchronize(device)
        begin = time.perf_counter()
        for _ in range(calls):
            run()
        synchronize(device)
        elapsed = time.perf_counter() - begin
        if elapsed >= seconds:
            return elapsed / calls
        calls = min(10 * calls, math.ceil(1.2 * calls * seconds / max(elapsed, 1e-9)))


class PartClock:
    """Adds up the time of functions, by name.

    On a GPU two CUDA events stand around each call, on the current stream: the time between them
    is that of the call's kernels, and of waiting for the host where it launches too slowly. On the
    CPU it is the host's clock.

    Args:
        device: where the functions do their work.
    """

    def __init__(self, device: torch.device) -> None:
        self._device = device
        self._seconds: defaultdict[str, float] = defaultdict(float)
        self._events: list[tuple[str, torch.cuda.Event, torch.cuda.Event]] = []

    def timed(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return the function with its time added to that of ``name``."""
        return (
            self._on_gpu(name, function)
            if self._device.type == "cuda"
            else self._on_cpu(name, function)
        )

    def seconds(self) -> dict[str, float]:
        """Wait for the device; return the time of each name so far [s]."""
        synchronize(self._device)
        for name, begin, end in self._events:
            self._seconds[name] += begin.elapsed_time(end) / 1000
        self._events.clear()
        return dict(self._seconds)

    def _on_cpu(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            begin = time.perf_counter()
            result = function(*arguments, **options)
            self._seconds[name] += time.perf_counter() - begin
            return result

        return call

    def _on_gpu(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            begin, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))
            begin.record()
            result = function(*arguments, **options)
            end.record()
            self._events.append((name, begin, end))
            return result

        return call
