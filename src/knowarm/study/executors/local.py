"""Local executor: one process per run on this machine."""

import os
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import psutil

from knowarm.cores import available_cores, limited_to
from knowarm.errors import UserError
from knowarm.study.executors.base import Ended, RunKey, Where, log_path

TIMEOUT_S = 10.0
"""How long `LocalExecutor.close` waits for its workers before it kills them [s]."""


@dataclass(frozen=True, kw_only=True)
class Local(Where):
    """Processes on this machine."""

    kind: Literal["local"] = "local"
    """Identifies the executor in a file."""

    at_once: int | None = None
    """Runs at once; None follows from cores, free memory and GPUs."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.at_once is not None and self.at_once < 1:
            raise UserError(f"where.at_once must be at least 1, got {self.at_once}.")


@dataclass
class _Worker:
    """A running process and the slot it occupies."""

    process: "subprocess.Popen[bytes]"
    slot: int


@dataclass
class LocalExecutor:
    """Pool of processes; a worker ends when the process that started it exits.

    Args:
        where: the settings.
        out: the study's folder.

    Raises:
        UserError: the machine has fewer cores, memory or GPUs than one run needs.
    """

    where: Local
    out: Path
    _workers: dict[RunKey, _Worker] = field(default_factory=dict)

    def __post_init__(self) -> None:
        where, memory = self.where, psutil.virtual_memory()
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
        if where.gpus:
            slots = min(slots, self._per_gpu * len(self._gpus))
        self._slots = where.at_once or max(1, slots)

    @property
    def slots(self) -> int:
        """As `Executor.slots`."""
        return self._slots

    @property
    def _per_gpu(self) -> int:
        return max(1, int(1 / self.where.gpus))

    def start(self, run: RunKey) -> None:
        """As `Executor.start`."""
        used = {worker.slot for worker in self._workers.values()}
        slot = next(number for number in range(self._slots) if number not in used)
        environment = os.environ | limited_to(self.where.cores)
        if self._gpus:
            gpu = self._gpus[slot // self._per_gpu % len(self._gpus)]
            environment["CUDA_VISIBLE_DEVICES"] = gpu
        with log_path(self.out, run).open("ab") as log:
            process = subprocess.Popen(
                [sys.executable, "-m", "knowarm.study.worker", str(self.out), run[0], str(run[1])],
                stdin=subprocess.PIPE,  # closes when this process ends, however it ends
                stdout=log,
                stderr=log,
                env=environment,
                start_new_session=True,  # Ctrl-C is for this process, which then asks the workers
            )
        self._workers[run] = _Worker(process, slot)

    def ended(self) -> list[Ended]:
        """As `Executor.ended`."""
        ended = []
        for run, worker in list(self._workers.items()):
            if (code := worker.process.poll()) is None:
                continue
            del self._workers[run]
            assert worker.process.stdin is not None
            worker.process.stdin.close()
            if code < 0:
                ended.append(Ended(run, f"its process was killed by signal {-code}", killed=True))
            elif code > 0:
                ended.append(Ended(run, f"its process ended with exit code {code}"))
            else:
                ended.append(Ended(run))
        return ended

    def stop(self) -> None:
        """As `Executor.stop`."""
        for worker in self._workers.values():
            worker.process.terminate()

    def close(self) -> None:
        """As `Executor.close`."""
        self.stop()
        for worker in self._workers.values():
            try:
                worker.process.wait(TIMEOUT_S)
            except subprocess.TimeoutExpired:
                worker.process.kill()
                worker.process.wait()
        self._workers.clear()


def _gpus() -> list[str]:
    """Return the names of the visible GPUs, as ``CUDA_VISIBLE_DEVICES`` takes them."""
    import torch  # takes a second to import

    visible = [name for name in os.environ.get("CUDA_VISIBLE_DEVICES", "").split(",") if name]
    return visible or [str(i) for i in range(torch.cuda.device_count())]
