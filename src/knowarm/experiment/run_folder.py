"""Run folder: the files of one training run.

Layout of ``runs/<experiment>/<seed>/``::

    config.json            the resolved ExperimentConfig
    provenance.json        versions, commit, machine, policy sizes, parameter counts, knowledge
    knowledge.safetensors  the knowledge table (F, K), one row per facet or query
    perception.safetensors the perception module or grounding network, for agents that have one
    metrics.csv            one row per update (PPO) or log interval (A3C)
    evaluations.csv        one row per interim evaluation
    tensorboard/           the same curves for TensorBoard
    checkpoints/           latest, previous, best
    evaluation/<label>/    post-training evaluations
"""

import csv
import json
import logging
import math
import os
import platform
import re
import subprocess
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from safetensors.numpy import save

from knowarm.config import from_dict
from knowarm.cores import processor
from knowarm.errors import UserError
from knowarm.experiment.config import ExperimentConfig, StopWhen
from knowarm.experiment.migration import FORMAT, migrate_config, migrate_provenance, migrate_row
from knowarm.reading import UnreadableFileError, read_arrays, read_json, reading

log = logging.getLogger("knowarm.experiment")

PACKAGES = ("knowarm", "torch", "mujoco", "numpy", "numba", "gymnasium", "safetensors")


class RunExistsError(UserError):
    """A folder in which a new run is to start already holds one."""


@dataclass(frozen=True)
class RunFolder:
    """The files of one run.

    Attributes:
        path: the folder.
    """

    path: Path

    @classmethod
    def create(cls, path: Path) -> "RunFolder":
        """Make a new, empty run folder and check that it can be written to.

        Raises:
            RunExistsError: the folder already holds a run.
            UserError: the folder cannot be written to.
        """
        folder = cls(path)
        if folder.config_path.exists():
            raise RunExistsError(
                f"{path} already holds a run. Pass resume=True to continue it, or another seed."
            )
        try:
            path.mkdir(parents=True, exist_ok=True)
            probe = path / ".writable"
            probe.write_bytes(b"")
            probe.unlink()
        except OSError as error:
            raise UserError(
                f"Cannot write to the output folder {path}: {error.strerror or error}. Pass "
                "another runs folder."
            ) from error
        return folder

    @classmethod
    def open(cls, path: Path | str) -> "RunFolder":
        """Open an existing run folder.

        Raises:
            UserError: there is no such folder, or it holds no run of a format that can be read.
        """
        folder = cls(Path(path))
        if not folder.config_path.is_file():
            what = "has no config.json" if folder.path.is_dir() else "does not exist"
            raise UserError(
                f"{path} is not a run folder: it {what}. Give the folder of one seed, such as "
                "runs/irb120-full-fast/0."
            )
        found = folder.config().get("format")
        if found != FORMAT:
            raise UserError(
                f"{path} was written in run format {found!r}; this version reads formats 1 to "
                f"{FORMAT}. Read it with the version named in its provenance.json."
            )
        return folder

    @property
    def config_path(self) -> Path:
        """Path of the resolved configuration."""
        return self.path / "config.json"

    @property
    def checkpoints(self) -> Path:
        """Folder of the checkpoints."""
        return self.path / "checkpoints"

    @property
    def has_checkpoint(self) -> bool:
        """Whether training can resume; a damaged checkpoint counts."""
        return any((self.checkpoints / name).is_dir() for name in ("latest", "previous"))

    @property
    def tensorboard(self) -> Path:
        """Folder of the TensorBoard event files."""
        return self.path / "tensorboard"

    @property
    def metrics_path(self) -> Path:
        """Path of the training metrics."""
        return self.path / "metrics.csv"

    @property
    def evaluations_path(self) -> Path:
        """Path of the interim evaluations."""
        return self.path / "evaluations.csv"

    def evaluation(self, label: str) -> Path:
        """Folder of one post-training evaluation."""
        return self.path / "evaluation" / label

    def config(self) -> dict[str, Any]:
        """Read the resolved configuration as JSON values, in the current run format."""
        return migrate_config(read_json(self.config_path))

    def experiment(self) -> ExperimentConfig:
        """Read the configuration that the run was started with."""
        values = {name: value for name, value in self.config().items() if name != "format"}
        return from_dict(ExperimentConfig, values)

    def ended_early_at(self, rule: StopWhen | None) -> int | None:
        """Return the step at which an early end was reached, or None."""
        if rule is None or not self.evaluations_path.exists():
            return None
        rows = read_csv(self.evaluations_path)
        cells = [(number_in(row, "step"), number_in(row, "success")) for row in rows]
        return rule.met_at((int(a), b) for a, b in cells if a is not None and b is not None)

    def provenance(self) -> dict[str, Any]:
        """Read versions, machine, policy, parameter counts and knowledge of the run."""
        return migrate_provenance(read_json(self.path / "provenance.json"))

    def write_json(self, name: str, values: Mapping[str, Any]) -> None:
        """Write one of the folder's JSON files atomically."""
        write_json(self.path / name, values)

    def write_knowledge(self, table: np.ndarray) -> None:
        """Store the knowledge table (F, K), float32.

        Raises:
            UserError: the file cannot be written.
        """
        path = self.path / "knowledge.safetensors"
        with writing(path):
            path.write_bytes(save({"table": np.ascontiguousarray(table)}))

    def knowledge(self) -> np.ndarray:
        """Read the knowledge table (F, K), float32, that the policy was trained with."""
        file, remedy = self.path / "knowledge.safetensors", "Restore the file or train again."
        with reading(file, remedy):
            table = read_arrays(file, remedy=remedy)["table"]
            if table.ndim != 2 or table.dtype != np.float32 or not np.isfinite(table).all():
                raise ValueError("its table must be a matrix of finite float32 numbers")
            return table


class CsvLog:
    """Rows appended to a CSV file, each flushed as soon as it is written.

    The columns are those of the first row; a row with a new column rewrites the file once. Cells
    without a value stay empty.

    Args:
        path: the CSV file; created with the first row.
        keep_to_step: when a run resumes, rows of later steps are dropped, because training will
            produce them again, and rows whose step is damaged; None drops all rows.
        drop_steps: steps whose rows are dropped as well.
    """

    def __init__(
        self, path: Path, *, keep_to_step: int | None = None, drop_steps: Collection[int] = ()
    ):
        self._path = path
        self._columns: list[str] = []
        if path.exists():
            last = -math.inf if keep_to_step is None else keep_to_step
            rows = [
                row
                for row in self._read()
                if (step := number_in(row, "step")) is not None
                and step <= last
                and step not in drop_steps
            ]
            self._columns = list(dict.fromkeys(name for row in rows for name in row))
            self._rewrite(rows)

    def _read(self) -> list[dict[str, str]]:
        """Read the rows; set a file aside whose header is damaged, as no row of it is of use."""
        try:
            return read_csv(self._path)
        except UnreadableFileError as error:
            aside = self._path.with_suffix(".damaged")
            with writing(self._path):
                self._path.replace(aside)
            log.warning("%s Keeping it as %s and starting a new file.", error, aside.name)
            return []

    def write(self, row: Mapping[str, Any]) -> None:
        """Append one row and flush it.

        Raises:
            UserError: the file cannot be written.
        """
        if any(name not in self._columns for name in row):
            rows = read_csv(self._path) if self._columns else []
            self._columns += [name for name in row if name not in self._columns]
            self._rewrite(rows)
        with writing(self._path), self._path.open("a", newline="", encoding="utf-8") as file:
            csv.DictWriter(file, self._columns, lineterminator="\n").writerow(row)

    def _rewrite(self, rows: Sequence[Mapping[str, Any]]) -> None:
        temporary = self._path.with_suffix(".tmp")
        with writing(self._path):
            with temporary.open("w", newline="", encoding="utf-8") as file:
                if self._columns:
                    writer = csv.DictWriter(file, self._columns, restval="", lineterminator="\n")
                    writer.writeheader()
                    writer.writerows(rows)
            temporary.replace(self._path)


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn a failure to write a file of a running training into a `UserError`.

    Raises:
        UserError: an `OSError` was raised in the ``with`` block.
    """
    try:
        yield
    except OSError as error:
        raise UserError(
            f"Cannot write {path}: {error.strerror or error}. The last checkpoint is intact: free "
            "disk space, or move the run folder back to where the training started, and resume."
        ) from error


def read_csv(path: Path) -> list[dict[str, str]]:
    """Read the rows of a CSV log in the current run format.

    A last line that is incomplete is skipped, as a crash leaves it. Bytes that are not UTF-8 stay
    in their cell, cells beyond the header's are dropped, and missing ones are left out: the rest of
    the row remains useful.

    Raises:
        UnreadableFileError: the file cannot be read, or its header is damaged.
    """
    with reading(path, "Restore the file."):
        data = path.read_bytes()
        text = data.decode(errors="replace").replace("\0", "\ufffd")
        lines = re.findall(r"[^\n]*\n", text)  # without the end of an incomplete line
        reader = csv.DictReader(lines)
        if data and "step" not in (reader.fieldnames or ["step"]):
            raise ValueError("its first line names no column step")
        return [
            migrate_row({n: cell for n, cell in row.items() if n is not None and cell is not None})
            for row in reader
        ]


def number_in(row: Mapping[str, str], column: str) -> float | None:
    """Return a finite number of a CSV log; None for a cell that is empty, missing or damaged."""
    try:
        number = float(row[column])
    except (KeyError, ValueError):
        return None
    return number if math.isfinite(number) else None


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """Write a JSON object through a temporary file, so that readers never see a part of it.

    Raises:
        UserError: the file cannot be written.
    """
    temporary = path.with_name(path.name + ".tmp")
    try:
        temporary.write_text(json.dumps(values, indent=2) + "\n", encoding="utf-8")
        temporary.replace(path)
    except OSError as error:
        raise UserError(f"Cannot write {path}: {error.strerror}.") from error


def provenance() -> dict[str, Any]:
    """Return the versions of the packages that shape a result, the commit, and the machine."""
    return {
        "versions": {"python": platform.python_version()}
        | {name: package_version(name) for name in PACKAGES},
        "commit": _commit(),
        "machine": {
            "system": f"{platform.system()} {platform.release()}",
            "processor": processor(),
            "cores": os.cpu_count(),
            "memory_gib": round(psutil.virtual_memory().total / 2**30, 1),
        },
    }


def package_version(package: str) -> str | None:
    """Return the version of an installed package; None where it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _commit() -> str | None:
    """Commit of the checkout the package runs from, with "+changes" for uncommitted edits."""
    here = Path(__file__).parent
    try:
        commit = _git("rev-parse", "HEAD", at=here)
        return commit + ("+changes" if _git("status", "--porcelain", "-uno", at=here) else "")
    except (OSError, subprocess.CalledProcessError):
        return None  # installed from a wheel, or no git on the machine


def _git(*arguments: str, at: Path) -> str:
    return subprocess.run(
        ["git", "-C", str(at), *arguments], capture_output=True, text=True, check=True
    ).stdout.strip()
