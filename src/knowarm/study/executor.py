"""Executor of a study with one process per run on this machine, and how workers are started."""

import math
import os
import subprocess
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from typing import Any, Literal, NamedTuple, Self

import psutil

from knowarm.config import check_values
from knowarm.cores import available_cores, limited_to
from knowarm.errors import UserError

RunKey = tuple[str, int]
"""Experiment and training seed: names a run of a study."""

LOG = "log.txt"  # in a run folder: what its workers printed
TIMEOUT_S = 60.0
"""How long workers may take to save and end, whether they were asked to or the process that started
them has exited: they save after a whole round, and one of A3C on a loaded machine takes longer than
15 s."""


@dataclass(frozen=True, kw_only=True)
class Where:
    """Where the runs are executed, and what each occupies."""

    kind: Literal["local", "ray"] = "local"
    """Processes on this machine, or tasks of a Ray cluster whose nodes share the study's folder."""
    cores: int = 1
    """Cores of each run. Two runs of one core finish sooner than one run of two cores, twice."""
    memory_gib: float = 1.5
    """Memory of each run [GiB]."""
    gpus: float = 0
    """GPUs of each run, at most 1; 0.5 lets two runs share one."""
    retries: int = 5
    """How often a run whose process was killed resumes without a later checkpoint in between."""
    at_once: int | None = None
    """Runs at once; None follows from cores, free memory and GPUs."""

    def __post_init__(self) -> None:
        check_values(self, where="where")


class Ended(NamedTuple):
    """A worker that has ended: how, unless by itself, and whether a signal killed it."""

    run: RunKey
    problem: str | None = None
    killed: bool = False

    @classmethod
    def with_code(cls, run: RunKey, code: int) -> Self:
        """Describe the end of a process by its exit code."""
        if code < 0:
            return cls(run, f"its process was killed by signal {-code}", killed=True)
        if code > 0:
            return cls(run, f"its process ended with exit code {code}")
        return cls(run)


def folder_of(out: Path, run: RunKey) -> Path:
    """Return the folder of a run in that of its study."""
    experiment, seed = run
    return out / experiment / str(seed)


def start_worker(
    out: Path,
    run: RunKey,
    environment: Mapping[str, str],
    **options: Any,
) -> "subprocess.Popen[bytes]":
    """Start the worker of a run; it saves and ends when this process ends, however it ends.

    ``environment`` holds further variables, ``options`` are those of `subprocess.Popen`.
    """
    experiment, seed = run
    log_file = folder_of(out, run) / LOG
    log_file.parent.mkdir(parents=True, exist_ok=True)
    with log_file.open("ab") as log:
        return subprocess.Popen(
            [
                sys.executable,
                "-m",
                "knowarm.study.worker",
                str(out),
                experiment,
                str(seed),
            ],
            stdin=subprocess.PIPE,  # closes when this process ends
            stdout=log,
            stderr=log,
            env=os.environ | environment,
            **options,
        )


class LocalExecutor:
    """Pool of processes; a worker ends when the process that started it exits.

    Raises:
        UserError: the machine has fewer cores, memory or GPUs than one run needs.
    """

    def __init__(self, where: Where, out: Path) -> None:
        self._where = where
        self._out = out
        # With their slots.
        self._workers: dict[RunKey, tuple[int, subprocess.Popen[bytes]]] = {}
        self._deadline = math.inf  # when those that were asked to end are killed
        memory = psutil.virtual_memory()
        self._gpus = _gpus() if where.gpus else []
        limits = {
            "cores": (available_cores(), where.cores),
            "memory_gib": (memory.total / 2**30, where.memory_gib),
            "gpus": (len(self._gpus), where.gpus),
        }
        for name, (there, needed) in limits.items():
            if needed > there:
                raise UserError(
                    f"One run needs {needed:g} {name}, and this machine has {there:.3g}: choose a "
                    f"smaller where.{name}, or another machine."
                )
        by_memory = int(memory.available / 2**30 / where.memory_gib)
        slots = min(available_cores() // where.cores, by_memory)
        self._per_gpu = 1
        if where.gpus:
            self._per_gpu = max(1, int(1 / where.gpus))
            slots = min(slots, self._per_gpu * len(self._gpus))
        self.slots = where.at_once or max(1, slots)

    def start(self, run: RunKey) -> None:
        """Start the worker of a run."""
        used = {slot for slot, _ in self._workers.values()}
        slot = next(number for number in range(self.slots) if number not in used)
        environment = limited_to(self._where.cores)
        if self._gpus:
            gpu = self._gpus[slot // self._per_gpu % len(self._gpus)]
            environment["CUDA_VISIBLE_DEVICES"] = gpu
        # Ctrl-C is for this process, which then asks the workers
        process = start_worker(self._out, run, environment, start_new_session=True)
        self._workers[run] = slot, process

    def ended(self) -> list[Ended]:
        """Return the workers that have ended since the last call."""
        ended = []
        for run, (_, process) in list(self._workers.items()):
            if process.poll() is None and time.monotonic() > self._deadline:
                _kill(process)
            code = process.poll()
            if code is None:
                continue
            del self._workers[run]
            assert process.stdin is not None
            process.stdin.close()
            ended.append(Ended.with_code(run, code))
        return ended

    def stop(self) -> None:
        """Ask all workers to save a checkpoint and end; a stopped process would never do so."""
        for _, process in self._workers.values():
            if os.name == "nt" and process.stdin:
                process.stdin.close()  # a worker then stops; `terminate` would kill it
            else:
                process.terminate()
        self._deadline = min(self._deadline, time.monotonic() + TIMEOUT_S)

    def close(self) -> None:
        """End all workers."""
        self.stop()
        while self._workers:
            self.ended()
            time.sleep(0.05)


def _kill(process: "subprocess.Popen[bytes]") -> None:
    """Kill a worker and the processes that it started, which may be stopped as well."""
    with suppress(psutil.NoSuchProcess):
        for child in psutil.Process(process.pid).children(recursive=True):
            child.kill()
    process.kill()
    process.wait()


def _gpus() -> list[str]:
    """Return the names of the visible GPUs, as ``CUDA_VISIBLE_DEVICES`` takes them."""
    import torch  # takes a second to import

    names = os.environ.get("CUDA_VISIBLE_DEVICES", "").split(",")
    # As CUDA
    visible = list(takewhile(lambda name: name and not name.startswith("-"), names))
    return visible or [str(i) for i in range(torch.cuda.device_count())]
