"""Mirrors: the curves of a run in a tracking service, continued after a resume.

CSV files stay the source; a service that fails costs its copy, never the training.
"""

import importlib
import sys
import time
import uuid
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from knowarm.config import to_dict
from knowarm.errors import UserError
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.logs import Mirror
from knowarm.experiment.run_folder import read_json, write_json

FILE = "mirrors.json"
"""File in a run folder: the name of the run in each service."""


class WandbMirror:
    """A run of Weights & Biases, grouped by experiment; ``WANDB_MODE=offline`` needs no network."""

    def __init__(self, config: ExperimentConfig, folder: Path, study: str) -> None:
        wandb: Any = importlib.import_module("wandb")
        self._run = wandb.init(
            project=study,
            group=config.name,
            name=f"{config.name}/{config.seed}",
            id=_stored_id(folder, "wandb", lambda: uuid.uuid4().hex[:12]),
            resume="allow",
            config=to_dict(config),
            dir=folder,
            settings=wandb.Settings(console="off", silent=True),
        )

    def scalars(self, step: int, values: Mapping[str, float]) -> None:
        """As `Mirror.scalars`; the service itself ignores steps that it already has."""
        self._run.log(dict(values), step=step)

    def close(self) -> None:
        """As `Mirror.close`."""
        self._run.finish()


class MlflowMirror:
    """A run of MLflow, tagged with its experiment; ``MLFLOW_TRACKING_URI`` may be a folder."""

    def __init__(self, config: ExperimentConfig, folder: Path, study: str) -> None:
        mlflow: Any = importlib.import_module("mlflow")
        self._metric = importlib.import_module("mlflow.entities").Metric
        self._client = mlflow.MlflowClient()
        tags = {
            "mlflow.runName": f"{config.name}/{config.seed}",
            "experiment": config.name,
            "agent": config.agent,
            "seed": str(config.seed),
        }

        def create() -> str:
            found = self._client.get_experiment_by_name(study)
            where = found.experiment_id if found else self._client.create_experiment(study)
            return str(self._client.create_run(where, tags=tags).info.run_id)

        self._id = _stored_id(folder, "mlflow", create)
        self._client.update_run(self._id, "RUNNING")
        self._sent = self._client.get_run(self._id).data.metrics.get("step", -1)

    def scalars(self, step: int, values: Mapping[str, float]) -> None:
        """As `Mirror.scalars`; steps that were sent before a resume are not sent again."""
        if step <= self._sent:
            return
        now = int(1000 * time.time())
        metrics = [self._metric(k, v, now, step) for k, v in {**values, "step": step}.items()]
        self._client.log_batch(self._id, metrics=metrics)

    def close(self) -> None:
        """As `Mirror.close`."""
        self._client.set_terminated(self._id)


MIRRORS: dict[str, Callable[[ExperimentConfig, Path, str], Mirror]] = {
    "wandb": WandbMirror,
    "mlflow": MlflowMirror,
}
"""Tracking services by the name of their package."""


def check_mirror(name: str) -> None:
    """Check that the package of a service is installed.

    Raises:
        UserError: it is not.
    """
    try:
        importlib.import_module(name)
    except ImportError as error:
        raise UserError(f"The mirror {name!r} needs: pip install 'knowarm[tracking]'.") from error


def open_mirror(name: str, config: ExperimentConfig, folder: Path, study: str) -> Mirror:
    """Open the run of a service; its failures are printed once, then the mirror stays silent."""
    return _Guarded(name, lambda: MIRRORS[name](config, folder, study))


class _Guarded:
    """Mirror whose failures do not reach the training."""

    def __init__(self, name: str, make: Callable[[], Mirror]) -> None:
        self._name = name
        self._mirror: Mirror | None = None
        self._try(lambda: setattr(self, "_mirror", make()))

    def scalars(self, step: int, values: Mapping[str, float]) -> None:
        if (mirror := self._mirror) is not None:
            self._try(lambda: mirror.scalars(step, values))

    def close(self) -> None:
        if (mirror := self._mirror) is not None:
            self._try(mirror.close)

    def _try(self, call: Callable[[], None]) -> None:
        try:
            call()
        except Exception as error:  # whatever the service raises
            self._mirror = None
            print(f"The mirror {self._name!r} failed and is switched off: {error}", file=sys.stderr)


def _stored_id(folder: Path, name: str, create: Callable[[], str]) -> str:
    """Return the name of this run in a service, created once."""
    ids = read_json(folder / FILE) if (folder / FILE).exists() else {}
    if name not in ids:
        ids[name] = create()
        folder.mkdir(parents=True, exist_ok=True)
        write_json(folder / FILE, ids)
    return str(ids[name])
