"""Status of the runs of a study, derived from their folders every time."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

from knowarm.config import to_dict
from knowarm.errors import UserError
from knowarm.experiment.config import EvaluationConfig, ExperimentConfig
from knowarm.experiment.run import run_path
from knowarm.experiment.run_folder import RunFolder, read_csv
from knowarm.experiment.run_lock import is_locked
from knowarm.reading import read_json
from knowarm.study.config import StudyConfig
from knowarm.study.executors import RunKey

State = Literal["waiting", "running", "stalled", "failed", "trained", "done"]
"""State of a run:

- ``waiting``: not started;
- ``running``: a process holds its folder;
- ``stalled``: started, and nothing works on it (or its process is silent): it resumes with the
  next ``study run``;
- ``failed``: an error ended it; ``study retry`` lets it resume;
- ``trained``: all steps done, evaluations missing;
- ``done``: trained and evaluated.
"""

FAILURE = "failed.json"
"""File in a run folder: why the run failed. Without it the run can resume."""

SILENT_S = 900.0
"""Time without a written file after which a running run counts as stalled [s]."""


@dataclass(frozen=True, kw_only=True)
class RunStatus:
    """What is known about one run."""

    experiment: str
    seed: int
    state: State
    detail: str = ""
    """Why it failed or stalled, or how it ended early."""
    step: int = 0
    """Environment steps taken."""
    total_steps: int
    """Environment steps to take."""
    success: float | None = None
    """Success of the first post-training evaluation, or of the latest interim one."""
    steps_per_s: float | None = None
    """Latest rate."""
    seconds: float = 0.0
    """Time spent on training, without steps that were lost [s]."""

    @property
    def run(self) -> RunKey:
        """Experiment and seed."""
        return self.experiment, self.seed

    @property
    def steps_left(self) -> int:
        """Environment steps to go; 0 once trained."""
        finished = self.state in ("trained", "done")
        return 0 if finished else max(0, self.total_steps - self.step)


def study_status(study: StudyConfig, out: Path) -> list[RunStatus]:
    """Return the status of every run, in the order of the study."""
    return [run_status(config, study.evaluations, out) for config in study.runs()]


def run_status(
    config: ExperimentConfig, evaluations: Sequence[EvaluationConfig], out: Path
) -> RunStatus:
    """Return the status of one run."""
    path = run_path(out, config)
    folder = RunFolder(path)
    names: dict[str, Any] = {
        "experiment": config.name,
        "seed": config.seed,
        "total_steps": config.total_steps,
    }
    if not folder.config_path.exists():
        locked, failure = is_locked(path), _failure(path)
        state: State = "failed" if failure else "running" if locked else "waiting"
        return RunStatus(**names, state=state, detail=failure)
    names |= _progress(folder)
    if is_locked(path):
        silent = time.time() - _last_write(path)
        if silent > SILENT_S:
            detail = f"its process has written nothing for {silent / 60:.0f} minutes"
            return RunStatus(**names, state="stalled", detail=detail)
        return RunStatus(**names, state="running")
    if detail := _failure(path):
        return RunStatus(**names, state="failed", detail=detail)
    if not is_trained(folder, config):
        return RunStatus(**names, state="stalled", detail="resumes with the next study run")
    early = folder.ended_early_at(config.stop_when)
    detail = "" if early is None or early >= config.total_steps else f"ended early at {early:,}"
    if missing_evaluations(folder, evaluations):
        return RunStatus(**names, state="trained", detail=detail)
    if evaluations:
        summary = read_json(folder.evaluation(evaluations[0].folder) / "summary.json")
        names["success"] = summary["success"]
    return RunStatus(**names, state="done", detail=detail)


def is_trained(folder: RunFolder, config: ExperimentConfig) -> bool:
    """Return whether a run has taken all its steps and saved its last checkpoint."""
    early = folder.ended_early_at(config.stop_when)
    return checkpoint_step(folder) >= (config.total_steps if early is None else early)


def checkpoint_step(folder: RunFolder) -> int:
    """Return the step of the latest checkpoint; -1 without one."""
    for name in ("latest", "previous"):
        try:
            return int(read_json(folder.checkpoints / name / "meta.json")["facts"]["step"])
        except (UserError, KeyError, TypeError, ValueError):
            continue
    return -1


def missing_evaluations(
    folder: RunFolder, evaluations: Sequence[EvaluationConfig]
) -> list[EvaluationConfig]:
    """Return the evaluations that a run lacks, or has with other settings."""
    missing = []
    for evaluation in evaluations:
        try:
            summary = read_json(folder.evaluation(evaluation.folder) / "summary.json")
        except UserError:
            summary = {}
        if summary.get("config") != to_dict(evaluation):
            missing.append(evaluation)
    return missing


def totals(statuses: Sequence[RunStatus], cores: int) -> dict[str, Any]:
    """Return the number of runs per state, and the cost so far and to go.

    Args:
        statuses: of all runs.
        cores: of each run.

    Returns:
        ``states``, ``core_hours`` and ``core_hours_left``, training only; the latter is None while
        no rate is known. Runs without a rate of their own are assumed to have the mean rate.
    """
    counts: dict[str, int] = {}
    for status in statuses:
        counts[status.state] = counts.get(status.state, 0) + 1
    hours = cores / 3600
    left = seconds_left(statuses)
    known = all(status.run in left for status in statuses)
    return {
        "states": counts,
        "core_hours": hours * sum(status.seconds for status in statuses),
        "core_hours_left": hours * sum(left.values()) if known else None,
    }


def seconds_left(statuses: Sequence[RunStatus]) -> dict[RunKey, float]:
    """Return the expected training time left of each run; runs of unknown rate are left out."""
    rates: dict[str, list[float]] = {}
    for status in statuses:
        if status.steps_per_s:
            rates.setdefault(status.experiment, []).append(status.steps_per_s)
            rates.setdefault("", []).append(status.steps_per_s)
    left = {}
    for status in statuses:
        known = rates.get(status.experiment) or rates.get("") or []
        if not status.steps_left:
            left[status.run] = 0.0
        elif status.steps_per_s or known:
            left[status.run] = status.steps_left / (status.steps_per_s or sum(known) / len(known))
    return left


def _progress(folder: RunFolder) -> dict[str, Any]:
    """Read step, rate, time and interim success from the curves."""
    progress: dict[str, Any] = {}
    for path, read in (
        (folder.metrics_path, _training),
        (folder.evaluations_path, _interim_success),
    ):
        try:
            found = path.stat()
            progress |= read(path, found.st_mtime_ns, found.st_size)
        except OSError:  # not there yet, or being replaced
            continue
    return progress


@lru_cache(maxsize=2000)
def _training(path: Path, *version: int) -> Mapping[str, Any]:
    """Read a run's metrics; not again while the file is the same."""
    rows = read_csv(path)
    seconds, before = 0.0, 0.0
    for row in rows:
        now = float(row.get("wall_time_s") or 0)
        # The clock restarts whenever a training resumes.
        seconds, before = seconds + (now - before if now >= before else now), now
    last: Mapping[str, str] = rows[-1] if rows else {}
    return {
        "step": int(float(last.get("step") or 0)),
        "steps_per_s": float(last.get("steps_per_s") or 0) or None,
        "seconds": seconds,
    }


@lru_cache(maxsize=2000)
def _interim_success(path: Path, *version: int) -> Mapping[str, Any]:
    """Read the success of the latest interim evaluation."""
    success = [row["success"] for row in read_csv(path) if row.get("success")]
    return {"success": float(success[-1])} if success else {}


def _failure(path: Path) -> str:
    """Return the reason of a failure; empty if there is none."""
    if not (path / FAILURE).exists():
        return ""
    try:
        return str(read_json(path / FAILURE)["reason"])
    except (UserError, KeyError):
        return f"{path / FAILURE} is damaged"


def _last_write(path: Path) -> float:
    times = []
    for pattern in ("*", "checkpoints", "evaluation/*"):
        for each in path.glob(pattern):
            try:
                times.append(each.stat().st_mtime)
            except OSError:  # replaced meanwhile
                continue
    return max(times, default=time.time())
