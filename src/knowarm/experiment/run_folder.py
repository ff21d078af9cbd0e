"""A path goes in; the files of one training run, written safely and read back, come out.

Layout of ``runs/<experiment>/<seed>/``::

    config.json            the resolved ExperimentConfig
    provenance.json        versions, commit, machine, parameter counts, knowledge
    knowledge.safetensors  the table (F, K) the policy was given, a row a facet
    metrics.csv            one row an update interval
    evaluations.csv        one row an interim evaluation
    tensorboard/           the same curves for TensorBoard
    checkpoints/           latest, previous, best
    evaluation/<label>/    post-training evaluations
"""

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import load_file, save_file

from knowarm.errors import UserError
from knowarm.experiment.migration import FORMAT, migrate_config


@dataclass(frozen=True)
class RunFolder:
    """The files of one run.

    Attributes:
        path: the folder.
    """

    path: Path

    @classmethod
    def create(cls, path: Path) -> "RunFolder":
        """Make a new, empty run folder and prove that it can be written to.

        Raises:
            UserError: the folder already holds a run, or cannot be written.
        """
        folder = cls(path)
        if folder.config_path.exists():
            raise UserError(
                f"{path} already holds a run. Give --resume to go on with it, or another --seed "
                "or --runs folder to start a new one."
            )
        try:
            path.mkdir(parents=True, exist_ok=True)
            probe = path / ".writable"
            probe.write_bytes(b"")
            probe.unlink()
        except OSError as error:
            raise UserError(
                f"Cannot write to the output folder {path}: {error.strerror or error}. Choose "
                "another one with --runs."
            ) from error
        return folder

    @classmethod
    def open(cls, path: Path | str) -> "RunFolder":
        """Open an existing run folder.

        Raises:
            UserError: there is no such folder, or it does not hold a run of this format.
        """
        folder = cls(Path(path))
        if not folder.config_path.is_file():
            what = "has no config.json" if folder.path.is_dir() else "does not exist"
            raise UserError(
                f"{path} is not a run folder: it {what}. Give the folder of one seed, such as "
                "runs/irb120-full-ppo/0."
            )
        found = folder.config().get("format")
        if found != FORMAT:
            raise UserError(
                f"{path} was written in run format {found!r}; this version reads format {FORMAT}. "
                "Read it with the version named in its provenance.json."
            )
        return folder

    @property
    def config_path(self) -> Path:
        """The resolved configuration."""
        return self.path / "config.json"

    @property
    def checkpoints(self) -> Path:
        """Folder of the checkpoints."""
        return self.path / "checkpoints"

    @property
    def has_checkpoint(self) -> bool:
        """Whether training can go on from somewhere; a damaged checkpoint counts."""
        return any((self.checkpoints / name).is_dir() for name in ("latest", "previous"))

    @property
    def tensorboard(self) -> Path:
        """Folder of the TensorBoard event files."""
        return self.path / "tensorboard"

    @property
    def metrics_path(self) -> Path:
        """Curves of the training itself."""
        return self.path / "metrics.csv"

    @property
    def evaluations_path(self) -> Path:
        """Curves of the interim evaluations."""
        return self.path / "evaluations.csv"

    def evaluation(self, label: str) -> Path:
        """Folder of one post-training evaluation."""
        return self.path / "evaluation" / label

    def config(self) -> dict[str, Any]:
        """The resolved configuration as JSON values, in the current run format."""
        return migrate_config(read_json(self.config_path))

    def provenance(self) -> dict[str, Any]:
        """Versions, machine, parameter counts and knowledge of the run."""
        return read_json(self.path / "provenance.json")

    def write_json(self, name: str, values: Mapping[str, Any]) -> None:
        """Write one of the folder's JSON files, whole or not at all."""
        write_json(self.path / name, values)

    def write_knowledge(self, table: np.ndarray) -> None:
        """Store the knowledge table (F, K), float32."""
        save_file({"table": np.ascontiguousarray(table)}, self.path / "knowledge.safetensors")

    def knowledge(self) -> np.ndarray:
        """The knowledge table (F, K), float32, that the policy was trained with."""
        file = self.path / "knowledge.safetensors"
        try:
            return load_file(file)["table"]
        except Exception as error:  # safetensors raises its own, undocumented error types
            raise UserError(
                f"{file} cannot be read ({error}). The run folder is damaged: restore the file "
                "or train again."
            ) from error


class CsvLog:
    """Rows appended to a CSV file, each on disk as soon as it is written.

    The columns are those of the first row; a row that brings a new column rewrites the file
    once. Cells a row does not have stay empty.
    """

    def __init__(self, path: Path, *, keep_to_step: int | None = None):
        """Open the log.

        Args:
            path: the CSV file; created with the first row.
            keep_to_step: when a run resumes, rows of later steps are dropped: they will be
                produced again.
        """
        self._path = path
        self._columns: list[str] = []
        if path.exists():
            rows = [row for row in read_csv(path) if keep_to_step is not None]
            rows = [row for row in rows if float(row["step"] or 0) <= (keep_to_step or 0)]
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
    """Rows of a CSV log; a last line that a crash cut short is left out."""
    lines = path.read_text().splitlines(keepends=True)
    if lines and not lines[-1].endswith("\n"):
        lines.pop()
    return list(csv.DictReader(lines))


def read_json(path: Path) -> dict[str, Any]:
    """Values of a JSON file.

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
    """Write JSON by way of a temporary file, so that readers never see half of it.

    Raises:
        UserError: the place cannot be written to.
    """
    temporary = path.with_name(path.name + ".tmp")
    try:
        temporary.write_text(json.dumps(values, indent=2) + "\n")
        temporary.replace(path)
    except OSError as error:
        raise UserError(f"Cannot write {path}: {error.strerror}.") from error
