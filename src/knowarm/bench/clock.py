"""Timing of work on a device: seconds per call, and seconds per named part."""

import math
import os
import statistics
import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import psutil
import torch

HOST_ROUNDS, HOST_CALLS = 9, 5
"""Rounds, and calls per round, of ``host_seconds_per_call``. A GPU's queue holds 1,024 launches."""


def cpu_seconds() -> float:
    """Return the CPU time used so far by this process and all of its child processes [s]."""
    # The system counts other processes' time in ticks of 10 ms: a short measurement may see none.
    running = psutil.Process().children(recursive=True)
    ended = sum(os.times()[2:4])
    return time.process_time() + ended + sum(sum(child.cpu_times()[:4]) for child in running)


def synchronize(device: torch.device) -> None:
    """Wait until a device has finished all launched work. Does nothing for the CPU."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def seconds_per_call(run: Callable[[], Any], seconds: float, device: torch.device) -> float:
    """Measure the mean time of a call of ``run``.

    The number of calls is fixed before each measurement and increased until the measurement lasts
    long enough, so that nothing waits for the device between calls.

    Args:
        run: function to time. Call it a few times before, so that no compilation is included.
        seconds: minimum length of the measurement [s].
        device: device on which the work is done.

    Returns:
        Time per call by the host's clock [s].
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


def host_seconds_per_call(run: Callable[[], Any], device: torch.device) -> float:
    """Measure the time that the host needs to issue a call of ``run``, without waiting for it.

    The device is idle before each round of a few calls, so that no launch waits for a place in its
    queue. On the CPU the host does the work itself, and the time includes it.

    Args:
        run: function to time; called ``HOST_ROUNDS`` x ``HOST_CALLS`` times.
        device: device on which the work is done.

    Returns:
        Median over the rounds of the time per call by the host's clock [s].
    """
    rounds = []
    for _ in range(HOST_ROUNDS):
        synchronize(device)
        begin = time.perf_counter()
        for _ in range(HOST_CALLS):
            run()
        rounds.append((time.perf_counter() - begin) / HOST_CALLS)
    synchronize(device)
    return statistics.median(rounds)


class PartClock:
    """Total time spent in functions, by name.

    On a GPU, two CUDA events on the current stream enclose each call: the time between them is the
    time of the call's kernels, plus idle time if the host launches too slowly. On the CPU the
    host's clock is used.

    Args:
        device: device on which the functions do their work.
    """

    def __init__(self, device: torch.device) -> None:
        self._device = device
        self._seconds: defaultdict[str, float] = defaultdict(float)
        self._events: list[tuple[str, torch.cuda.Event, torch.cuda.Event]] = []
        self._timed_methods: list[tuple[Any, str]] = []

    def timed(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return the function wrapped so that its time is added to the total of ``name``."""
        wrap = self._on_gpu if self._device.type == "cuda" else self._on_cpu
        return wrap(name, function)

    def time_methods(self, name: str, owner: Any, *methods: str) -> None:
        """Add the time of an object's methods to the total of ``name``, until ``restore``."""
        for method in methods:
            setattr(owner, method, self.timed(name, getattr(owner, method)))
            self._timed_methods.append((owner, method))

    def restore(self) -> None:
        """Stop timing methods: the objects use the methods of their classes again."""
        for owner, method in self._timed_methods:
            delattr(owner, method)
        self._timed_methods.clear()

    def seconds(self) -> dict[str, float]:
        """Wait for the device and return the total time of each name so far [s]."""
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
