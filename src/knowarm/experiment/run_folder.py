"""Run folder: the files of one training run.

Layout of ``runs/<experiment>/<seed>/``::

    config.json            the resolved ExperimentConfig
    provenance.json        versions, commit, machine, policy sizes, parameter counts, knowledge
    knowledge.safetensors  the policy's knowledge table (F, K), one row per facet
    metrics.csv            one row per update (PPO) or log interval (A3C)
    evaluations.csv        one row per interim evaluation
    tensorboard/           the same curves for TensorBoard
    checkpoints/           latest, previous, best
    evaluation/<label>/    post-training evaluations
"""

import csv
import json
import os
import platform
import subprocess
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from safetensors.numpy import load_file, save_file

from knowarm.config import from_dict
from knowarm.cores import processor
from knowarm.errors import UserError
from knowarm.experiment.config import ExperimentConfig, StopWhen
from knowarm.experiment.migration import FORMAT, migrate_config, migrate_provenance, migrate_row

PACKAGES = ("knowarm", "torch", "mujoco", "numpy", "numba", "gymnasium", "safetensors")


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
            UserError: the folder already holds a run, or cannot be written to.
        """
        folder = cls(path)
        if folder.config_path.exists():
            raise UserError(
                f"{path} already holds a run. Pass resume=True to continue it, or another seed or "
                "runs folder to start a new one."
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
        return rule.met_at((int(float(row["step"])), float(row["success"])) for row in rows)

    def provenance(self) -> dict[str, Any]:
        """Read versions, machine, policy, parameter counts and knowledge of the run."""
        return migrate_provenance(read_json(self.path / "provenance.json"))

    def write_json(self, name: str, values: Mapping[str, Any]) -> None:
        """Write one of the folder's JSON files atomically."""
        write_json(self.path / name, values)

    def write_knowledge(self, table: np.ndarray) -> None:
        """Store the knowledge table (F, K), float32."""
        save_file({"table": np.ascontiguousarray(table)}, self.path / "knowledge.safetensors")

    def knowledge(self) -> np.ndarray:
        """Read the knowledge table (F, K), float32, that the policy was trained with."""
        file = self.path / "knowledge.safetensors"
        try:
            return load_file(file)["table"]
        except Exception as error:  # safetensors raises its own, undocumented error types
            raise UserError(
                f"{file} cannot be read ({error}). The run folder is damaged: restore the file "
                "or train again."
            ) from error


class CsvLog:
    """Rows appended to a CSV file, each flushed as soon as it is written.

    The columns are those of the first row; a row with a new column rewrites the file once. Cells
    without a value stay empty.

    Args:
        path: the CSV file; created with the first row.
        keep_to_step: when a run resumes, rows of later steps are dropped, because training will
            produce them again; None drops all rows.
        drop_steps: steps whose rows are dropped as well.
    """

    def __init__(
        self, path: Path, *, keep_to_step: int | None = None, drop_steps: Collection[int] = ()
    ):
        self._path = path
        self._columns: list[str] = []
        if path.exists():
            rows = [row for row in read_csv(path) if keep_to_step is not None]
            rows = [row for row in rows if float(row["step"] or 0) <= (keep_to_step or 0)]
            rows = [row for row in rows if float(row["step"] or 0) not in drop_steps]
            self._columns = list(rows[0]) if rows else []
            self._rewrite(rows)

    def write(self, row: Mapping[str, Any]) -> None:
        """Append one row and flush it."""
        if any(name not in self._columns for name in row):
            rows = read_csv(self._path) if self._columns else []
            self._columns += [name for name in row if name not in self._columns]
            self._rewrite(rows)
        with self._path.open("a", newline="") as file:
            csv.DictWriter(file, self._columns, lineterminator="\n").writerow(row)

    def _rewrite(self, rows: Sequence[Mapping[str, Any]]) -> None:
        temporary = self._path.with_suffix(".tmp")
        with temporary.open("w", newline="") as file:
            if self._columns:
                writer = csv.DictWriter(file, self._columns, restval="", lineterminator="\n")
                writer.writeheader()
                writer.writerows(rows)
        temporary.replace(self._path)


def read_csv(path: Path) -> list[dict[str, str]]:
    """Read the rows of a CSV log in the current run format; skip a last line that is incomplete."""
    lines = path.read_text().splitlines(keepends=True)
    if lines and not lines[-1].endswith("\n"):
        lines.pop()
    return [migrate_row(row) for row in csv.DictReader(lines)]


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object.

    Raises:
        UserError: the file is missing, not JSON, or holds no object.
    """
    try:
        values = json.loads(path.read_text())
    except OSError as error:
        raise UserError(f"Cannot read {path}: {error.strerror}.") from error
    except ValueError as error:
        raise UserError(f"{path} is not valid JSON: {error}.") from error
    if not isinstance(values, dict):
        raise UserError(f"{path} must hold a JSON object, got {type(values).__name__}.")
    return values


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """Write a JSON object through a temporary file, so that readers never see a part of it.

    Raises:
        UserError: the file cannot be written.
    """
    temporary = path.with_name(path.name + ".tmp")
    try:
        temporary.write_text(json.dumps(values, indent=2) + "\n")
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
