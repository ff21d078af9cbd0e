"""Executor interface: starts workers and tells which have ended."""

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from knowarm.errors import UserError

RunKey = tuple[str, int]
"""Experiment and training seed: names a run of a study."""

LOG = "log.txt"
"""File in a run folder: what its workers printed."""


@dataclass(frozen=True, kw_only=True)
class Where:
    """Settings of an executor, and what each run occupies; kinds differ in a literal ``kind``."""

    kind: str
    """Name of the executor; a literal field of each kind."""

    cores: int = 1
    """Cores of each run. Two runs of one core finish sooner than one run of two cores, twice."""

    memory_gib: float = 1.5
    """Memory of each run [GiB]."""

    gpus: float = 0
    """GPUs of each run; 0.5 lets two runs share one."""

    retries: int = 5
    """How often a run whose process was killed resumes without a later checkpoint in between."""

    def __post_init__(self) -> None:
        if self.cores < 1:
            raise UserError(f"where.cores must be at least 1, got {self.cores}.")
        if self.retries < 0 or self.gpus < 0:
            raise UserError("where.retries and where.gpus must be 0 or more.")
        if not self.memory_gib > 0:
            raise UserError(f"where.memory_gib must be above 0, got {self.memory_gib}.")


@dataclass(frozen=True)
class Ended:
    """A worker that has ended."""

    run: RunKey
    problem: str | None = None
    """How it ended, unless it ended by itself."""
    killed: bool = False
    """Whether something outside the program ended it, so that trying again makes sense."""


class Executor(Protocol):
    """Starts workers."""

    @property
    def slots(self) -> int:
        """How many runs it can execute at once, now."""
        ...

    def start(self, run: RunKey) -> None:
        """Start the worker of a run."""
        ...

    def ended(self) -> list[Ended]:
        """Return the workers that have ended since the last call."""
        ...

    def stop(self) -> None:
        """Ask all workers to save a checkpoint and end."""
        ...

    def close(self) -> None:
        """End all workers at once and release everything."""
        ...


def log_path(out: Path, run: RunKey) -> Path:
    """Return the log of a run, with its folder created."""
    folder = out / run[0] / str(run[1])
    folder.mkdir(parents=True, exist_ok=True)
    return folder / LOG
