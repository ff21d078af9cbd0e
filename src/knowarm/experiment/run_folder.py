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

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import save

from knowarm.config import from_dict, to_dict
from knowarm.errors import UserError
from knowarm.experiment.config import ExperimentConfig, StopWhen
from knowarm.experiment.csv_log import number_in, read_csv, writing
from knowarm.reading import read_arrays, read_json, reading, write_json

FORMAT = 1
"""Version of the run folder's layout."""


class RunExistsError(UserError):
    """A folder in which a new run is to start already holds one."""


@dataclass
class RunFolder:
    """The files of one run in the folder ``path``."""

    path: Path

    def __post_init__(self) -> None:
        self.config_path = self.path / "config.json"
        self.checkpoints = self.path / "checkpoints"
        self.tensorboard = self.path / "tensorboard"
        self.metrics_path = self.path / "metrics.csv"
        self.evaluations_path = self.path / "evaluations.csv"

    @classmethod
    def create(cls, path: Path) -> "RunFolder":
        """Make a new, empty run folder and check that it can be written to."""
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
        """Open an existing run folder, of a format that can be read."""
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
                f"{path} was written in run format {found!r}; this version reads format "
                f"{FORMAT}. Read it with the version named in its provenance.json."
            )
        return folder

    @property
    def has_checkpoint(self) -> bool:
        """Whether training can resume; a damaged checkpoint counts."""
        return any((self.checkpoints / name).is_dir() for name in ("latest", "previous"))

    def evaluation(self, label: str) -> Path:
        """Folder of one post-training evaluation."""
        return self.path / "evaluation" / label

    def config(self) -> dict[str, Any]:
        """Read the resolved configuration as JSON values."""
        return read_json(self.config_path)

    def experiment(self) -> ExperimentConfig:
        """Read the configuration that the run was started with."""
        values = self.config()
        values.pop("format", None)
        return from_dict(ExperimentConfig, values)

    def write_experiment(self, config: ExperimentConfig) -> None:
        """Write the configuration; a folder with one holds a run."""
        self.write_json("config.json", {"format": FORMAT, **to_dict(config)})

    def ended_early_at(self, rule: StopWhen | None) -> int | None:
        """Return the step at which an early end was reached, or None."""
        if rule is None or not self.evaluations_path.exists():
            return None
        rows = read_csv(self.evaluations_path)
        cells = [(number_in(row, "step"), number_in(row, "success")) for row in rows]
        return rule.met_at((int(a), b) for a, b in cells if a is not None and b is not None)

    def provenance(self) -> dict[str, Any]:
        """Read what a run was trained with, and on."""
        return read_json(self.path / "provenance.json")

    def write_json(self, name: str, values: Mapping[str, Any]) -> None:
        """Write one of the folder's JSON files atomically."""
        write_json(self.path / name, values)

    def write_knowledge(self, table: np.ndarray) -> None:
        """Store the knowledge table (F, K), float32."""
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
