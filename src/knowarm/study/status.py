"""Status of the runs of a study, derived from their folders every time."""

import time
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

from knowarm.errors import UserError
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.csv_log import number_in, read_csv, training_seconds
from knowarm.experiment.evaluation import EvaluationConfig
from knowarm.experiment.run import run_path
from knowarm.experiment.run_folder import RunFolder
from knowarm.experiment.run_lock import is_locked
from knowarm.experiment.summary import Summary
from knowarm.reading import read_json, reading
from knowarm.study.config import StudyConfig
from knowarm.study.executor import RunKey
from knowarm.world.robots import find_robot

State = Literal[
    "waiting",  # not started
    "running",  # a process holds its folder
    "stalled",  # a process holds its folder, and has written nothing for a while
    "stopped",  # its process ended before the last step; `study run` resumes it
    "paused",  # has reached the step at which the last `study run` was to pause it
    "failed",  # an error ended it; ``study retry`` lets it resume
    "damaged",  # a file of its folder cannot be read; `study run` leaves it alone
    "trained",  # all steps done, evaluations missing
    "done",  # trained and evaluated
]

Facts = dict[str, Any]
Evaluations = Sequence[EvaluationConfig]
PAUSE = "until-step"  # in a study's folder: the step at which all its runs pause
# In a run folder: why the run failed; without it the run can resume.
FAILURE = "failed.json"
# Time without a written file after which a running run counts as stalled.
SILENT_S = 900.0


@dataclass(frozen=True, kw_only=True)
class RunStatus:
    """What is known about one run."""

    experiment: str
    seed: int
    state: State
    detail: str = ""  # why it failed, stalled or stopped, or how it ended early
    step: int = 0  # environment steps taken
    total_steps: int
    # Of the first post-training evaluation, or the latest interim one.
    success: float | None = None
    best_return: float | None = None  # of the best interim evaluation
    best_step: int | None = None  # of the best interim evaluation
    steps_per_s: float | None = None  # latest rate
    seconds: float = 0.0  # time spent on training, without steps that were lost

    @property
    def run(self) -> RunKey:
        """Experiment and seed."""
        return self.experiment, self.seed

    @property
    def name(self) -> str:
        """``<experiment>/<seed>``: the run's folder in that of the study."""
        return f"{self.experiment}/{self.seed}"

    @property
    def steps_left(self) -> int:
        """Environment steps to go; 0 once trained."""
        if self.state in ("trained", "done"):
            return 0
        return max(0, self.total_steps - self.step)


def study_status(study: StudyConfig, out: Path) -> list[RunStatus]:
    """Return the status of every run, in the order of the study."""
    return [run_status(config, study.evaluations, out) for config in study.runs()]


def run_status(
    config: ExperimentConfig,
    evaluations: Evaluations,
    out: Path,
) -> RunStatus:
    """Return the status of one run; damage to its files is a state of its own."""
    folder = RunFolder(run_path(out, config))
    facts: Facts = {}
    try:
        facts |= _progress(folder)
        state, detail = _state(folder, config, evaluations, pause_step(out))
        facts |= {"state": state, "detail": detail}
        if state == "done" and evaluations:
            facts["success"] = _summary(folder, evaluations[0])["success"]
    except UserError as error:
        facts |= {"state": "damaged", "detail": str(error)}
    steps = config.total_steps
    return RunStatus(
        experiment=config.name, seed=config.seed, total_steps=steps, **facts
    )


def _state(
    folder: RunFolder,
    config: ExperimentConfig,
    evaluations: Evaluations,
    pause: int | None,
) -> tuple[State, str]:
    """Return the state of a run, and why it failed, stalled or stopped, or how it ended early."""
    path = folder.path
    failure = _failure(path)
    locked = is_locked(path)
    is_started = folder.config_path.exists()
    if failure and not (locked and is_started):
        return "failed", failure
    if locked:
        silent = time.time() - _last_write(path)
        if is_started and silent > SILENT_S:
            minutes = f"{silent / 60:.0f} min"
            return "stalled", f"its process has written nothing for {minutes}"
        return "running", ""
    if not is_started:
        return "waiting", ""
    if not is_trained(folder, config):
        step = folder.checkpoint_fact("step", -1)
        if pause is not None and step >= pause:
            goes_on = "goes on with a larger --until-step, or without"
            return "paused", f"at step {step:,}; {goes_on}"
        return "stopped", "resumes with the next study run"
    detail = ""
    early = folder.ended_early_at(config.stop_when)
    if early is not None and early < config.total_steps:
        detail = f"ended early at {early:,}"
    return "trained" if missing_evaluations(folder, evaluations) else "done", detail


def pause_step(out: Path) -> int | None:
    """Return the step at which the runs of a study pause, or None."""
    file = out / PAUSE
    if not file.exists():
        return None
    with reading(file, "Remove the file, or run the study again."):
        return int(file.read_text(encoding="utf-8"))


def is_trained(folder: RunFolder, config: ExperimentConfig) -> bool:
    """Return whether a run has taken all its steps, and no interim evaluation is pending."""
    early = folder.ended_early_at(config.stop_when)
    step = folder.checkpoint_fact("step", -1)
    if early is not None:
        return step >= early
    return step >= config.total_steps and folder.checkpoint_fact("pending", -1) < 1


def runs_beside(study: StudyConfig, out: Path) -> list[str]:
    """Return the runs in the folder of a study that are not of the study."""
    folders = {file.parent for file in out.glob("*/*/config.json")}
    known = {run_path(out, config) for config in study.runs()}
    return [folder.relative_to(out).as_posix() for folder in sorted(folders - known)]


def missing_evaluations(
    folder: RunFolder, evaluations: Evaluations
) -> list[EvaluationConfig]:
    """Return the evaluations that a run lacks, or has with other settings."""
    missing = []
    for evaluation in evaluations:
        made_with = None
        with suppress(UserError):
            made_with = _summary(folder, evaluation).config
        if made_with is not None and made_with != evaluation:
            robot = find_robot(folder.experiment().env.robot)
            evaluation = evaluation.of_robot(robot)
        if made_with != evaluation:
            missing.append(evaluation)
    return missing


def _summary(folder: RunFolder, evaluation: EvaluationConfig) -> Summary:
    """Read settings and numbers of one of a run's evaluations."""
    return Summary.read(folder.evaluation(evaluation.folder), with_groups=False)


def totals(statuses: Sequence[RunStatus], cores: int) -> Facts:
    """Return the number of runs per state, and the cost of training so far and to go.

    ``core_hours_left`` is None while no rate is known; runs without a rate are assumed to have the
    mean rate.
    """
    hours = cores / 3600
    left = seconds_left(statuses)
    hours_left = None
    if len(left) == len(statuses):
        hours_left = hours * sum(left.values())
    return {
        "states": dict(Counter(status.state for status in statuses)),
        "core_hours": hours * sum(status.seconds for status in statuses),
        "core_hours_left": hours_left,
    }


def seconds_left(statuses: Sequence[RunStatus]) -> dict[RunKey, float]:
    """Return the expected training time left of each run; runs of unknown rate are left out."""
    all_rates = []
    by_experiment: dict[str, list[float]] = {}
    for status in statuses:
        if status.steps_per_s:
            all_rates.append(status.steps_per_s)
            by_experiment.setdefault(status.experiment, []).append(status.steps_per_s)
    left = {}
    for status in statuses:
        rates = by_experiment.get(status.experiment, all_rates)
        if not status.steps_left:
            left[status.run] = 0.0
        elif rates:
            left[status.run] = status.steps_left / (
                status.steps_per_s or sum(rates) / len(rates)
            )
    return left


def _progress(folder: RunFolder) -> Facts:
    """Read step, rate, time and interim success from the curves."""
    progress: Facts = {}
    curves = {folder.metrics_path: _training, folder.evaluations_path: _interim}
    for path, read in curves.items():
        with suppress(OSError):  # not there yet, or being replaced
            stat = path.stat()
            progress |= read(path, stat.st_mtime_ns, stat.st_size)
    return progress


@lru_cache(maxsize=2000)
def _training(path: Path, *version: int) -> Facts:
    """Read a run's metrics; not again while the file is the same."""
    rows = read_csv(path)
    seconds = training_seconds(number_in(row, "wall_time_s") or 0.0 for row in rows)
    last = rows[-1] if rows else {}
    rate = number_in(last, "steps_per_s") or 0.0
    step = int(number_in(last, "step") or 0)
    return {"step": step, "steps_per_s": rate if rate > 0 else None, "seconds": seconds}


@lru_cache(maxsize=2000)
def _interim(path: Path, *version: int) -> Facts:
    """Read the success of the latest interim evaluation, and the best one."""
    rows = read_csv(path)
    values: Facts = {}
    for row in rows:
        success = number_in(row, "success")
        if success is not None:
            values["success"] = success
        if number_in(row, "best") == 1:
            step = number_in(row, "step")
            values["best_step"] = None if step is None else int(step)
            values["best_return"] = number_in(row, "return_mean")
    return values


def _failure(path: Path) -> str:
    """Return the reason of a failure; empty if there is none."""
    if not (path / FAILURE).exists():
        return ""
    with suppress(UserError, KeyError):
        return str(read_json(path / FAILURE)["reason"])
    return f"{path / FAILURE} is damaged"


def _last_write(path: Path) -> float:
    times = []
    for pattern in ("*", "checkpoints", "evaluation/*"):
        for file in path.glob(pattern):
            with suppress(OSError):  # replaced meanwhile
                times.append(file.stat().st_mtime)
    return max(times, default=time.time())
