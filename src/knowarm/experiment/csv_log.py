"""CSV logs of a training: rows that survive a crash and a resumed run."""

import csv
import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import partial
from itertools import chain
from pathlib import Path
from typing import IO, Any

import numpy as np

from knowarm.arrays import Floats
from knowarm.reading import reading, replacing
from knowarm.reading import writing as writing_file


class CsvLog:
    """Rows appended to a CSV file, each flushed as soon as it is written.

    A row with a new column rewrites the file once; cells without a value stay empty. On resuming,
    rows later than ``keep_to_step`` (None: all) and those of ``drop_steps`` are dropped.
    """

    def __init__(
        self,
        path: Path,
        *,
        keep_to_step: int | None = None,
        drop_steps: Collection[int] = (),
    ):
        self._path = path
        self._columns: list[str] = []
        if path.exists():
            last = -math.inf if keep_to_step is None else keep_to_step
            rows = []
            for row in read_csv(path):
                step = number_in(row, "step")
                if step is not None and step <= last and step not in drop_steps:
                    rows.append(row)
            self._rewrite(rows, *rows)

    def write(self, row: Mapping[str, Any]) -> None:
        """Append one row and flush it."""
        if not row.keys() <= set(self._columns):
            self._rewrite(read_csv(self._path) if self._columns else [], row)
        with writing(self._path), _opened(self._path, "a") as file:
            self._writer(file).writerow(row)

    def _rewrite(
        self,
        rows: Sequence[Mapping[str, Any]],
        *further: Iterable[str],
    ) -> None:
        """Write a file of some rows that has the columns of ``further`` ones, too."""
        columns = chain(self._columns, *further)
        self._columns = list(dict.fromkeys(columns))
        with replacing(self._path, REMEDY) as path, _opened(path, "w") as file:
            if self._columns:
                writer = self._writer(file)
                writer.writeheader()
                writer.writerows(rows)

    def _writer(self, file: IO[str]) -> "csv.DictWriter[str]":
        return csv.DictWriter(file, self._columns, lineterminator="\n")


def _opened(path: Path, mode: str) -> IO[str]:
    return path.open(mode, newline="", encoding="utf-8")


def training_seconds(clock: Iterable[float]) -> float:
    """Return the time of a training from its ``wall_time_s``, which restarts at every resume."""
    return float(training_clock(clock)[-1:].sum())


def training_clock(clock: Iterable[float]) -> Floats:
    """Return the time that a training had taken at each of its n ``wall_time_s``, (n,) [s]."""
    seconds = np.fromiter(clock, np.float64)
    passed = np.diff(seconds, prepend=0.0)
    return np.cumsum(np.where(passed < 0, seconds, passed))


REMEDY = (
    "The last checkpoint is intact: free disk space, or move the run folder back to where the "
    "training started, and resume."
)
writing = partial(writing_file, remedy=REMEDY)
"""Context manager in which a running training writes a file."""


def read_csv(path: Path) -> list[dict[str, str]]:
    """Read the complete rows of a CSV log; of damaged ones what is readable."""
    with reading(path, "Restore the file, or move it away: a new one is started."):
        text = path.read_bytes().decode(errors="replace").replace("\0", "\ufffd")
        lines = re.findall(r"[^\n]*\n", text)  # complete ones
        reader = csv.DictReader(lines)
        if "step" not in (reader.fieldnames or ["step"]):
            raise ValueError("its first line names no column step")
        rows = []
        for row in reader:
            row.pop(None, None)  # cells beyond the last column
            rows.append({name: cell for name, cell in row.items() if cell is not None})
        return rows


LARGEST = 1e15
"""Largest absolute value of a stored number; a larger one is taken for damage."""


def number_in(row: Mapping[str, str], column: str) -> float | None:
    """Return a number of a CSV log; None for a cell that is empty, missing or damaged."""
    try:
        number = float(row[column])
    except (KeyError, ValueError):
        return None
    return number if abs(number) <= LARGEST else None
