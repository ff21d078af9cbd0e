"""Tests of the clocks, with times that do not depend on the machine."""

from types import SimpleNamespace

import pytest
import torch

from knowarm.bench import clock as clock_module
from knowarm.bench.clock import (
    HOST_CALLS,
    HOST_ROUNDS,
    PartClock,
    host_seconds_per_call,
    seconds_per_call,
)

CPU = torch.device("cpu")


@pytest.fixture
def now(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Time of the host's clock [s]; only the test changes it."""
    now = [100.0]
    monkeypatch.setattr(clock_module, "time", SimpleNamespace(perf_counter=lambda: now[0]))
    return now


def test_a_call_is_timed_over_many_calls(now: list[float]) -> None:
    calls: list[int] = []

    def run() -> None:
        calls.append(1)
        now[0] += 0.25

    assert seconds_per_call(run, 3.0, CPU) == 0.25
    assert len(calls) == 1 + 10 + 15  # too short twice, then 1.2 x 3 s


def test_the_hosts_time_is_without_the_devices(
    now: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[int] = []
    queued: list[int] = []

    def issue() -> None:
        calls.append(1)
        queued.append(1)
        # The first round is slow, as others on the machine may make it.
        now[0] += 5.0 if len(calls) <= HOST_CALLS else 0.25

    def wait(device: torch.device) -> None:
        now[0] += 100.0 * len(queued)
        queued.clear()

    monkeypatch.setattr(torch.cuda, "synchronize", wait)
    assert host_seconds_per_call(issue, torch.device("cuda", 0)) == 0.25
    assert len(calls) == HOST_ROUNDS * HOST_CALLS
    assert not queued


def test_parts_are_added_up_by_name(now: list[float]) -> None:
    def wait(seconds: float) -> None:
        now[0] += seconds

    clock = PartClock(CPU)
    timed = clock.timed("wait", wait)
    timed(0.25)
    timed(0.5)
    assert clock.timed("other", lambda a, b=0: a + b)(1, b=2) == 3
    assert clock.seconds() == {"wait": 0.75, "other": 0.0}


def test_methods_are_timed_until_they_are_restored(now: list[float]) -> None:
    class Worker:
        def work(self, seconds: float) -> float:
            now[0] += seconds
            return seconds

    clock, worker = PartClock(CPU), Worker()
    clock.time_methods("work", worker, "work")
    assert worker.work(0.5) == 0.5
    clock.restore()
    worker.work(0.25)
    assert clock.seconds() == {"work": 0.5}
    assert not vars(worker)


def test_on_a_gpu_events_stand_around_each_call(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]

    class Event:
        """A CUDA event whose clock stands still between calls [ms]."""

        def __init__(self, enable_timing: bool) -> None:
            assert enable_timing

        def record(self) -> None:
            self.at = now[0]

        def elapsed_time(self, end: "Event") -> float:
            return end.at - self.at

    def work(milliseconds: float) -> None:
        now[0] += milliseconds

    monkeypatch.setattr(torch.cuda, "Event", Event)
    monkeypatch.setattr(torch.cuda, "synchronize", lambda device: None)
    clock = PartClock(torch.device("cuda", 0))
    physics, images = clock.timed("physics", work), clock.timed("images", work)
    clock.timed("whole", lambda: [physics(4), images(2), work(1), physics(3)])()
    assert clock.seconds() == {"physics": 0.007, "images": 0.002, "whole": 0.01}
    images(5)
    assert clock.seconds()["images"] == 0.007
