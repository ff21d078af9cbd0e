"""Executors: where the runs of a study are executed, by name.

To add one, write a module with a config (a `Where` with a literal ``kind``) and an `Executor`, and
add an entry here.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from knowarm.study.executors.base import Ended, Executor, RunKey, Where
from knowarm.study.executors.local import Local, LocalExecutor
from knowarm.study.executors.ray import Ray, RayExecutor

__all__ = ["EXECUTORS", "Ended", "Executor", "ExecutorEntry", "Local", "Ray", "RunKey", "Where"]


@dataclass(frozen=True, kw_only=True)
class ExecutorEntry:
    """One way to execute runs."""

    about: str
    """One line for the documentation of the command."""
    default: Where
    """Its default settings."""
    make: Callable[[Any, Path], Executor]
    """Checks the settings and connects, given a study's folder."""


EXECUTORS: dict[str, ExecutorEntry] = {
    "local": ExecutorEntry(
        about="a pool of processes on this machine", default=Local(), make=LocalExecutor
    ),
    "ray": ExecutorEntry(about="a Ray cluster (extra ray)", default=Ray(), make=RayExecutor),
}
"""Every executor by its ``kind``."""
