"""Driver of a study: starts workers until every run is done or failed; keeps no state of its own.

Everything it knows comes from the run folders, so it can be killed and started again at any time.
"""

import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from knowarm.errors import UserError, shell_command, unknown_name
from knowarm.experiment.run import other_fields, run_path
from knowarm.experiment.run_folder import RunFolder
from knowarm.experiment.run_lock import is_locked, lock_folder
from knowarm.study.config import (
    PACKED,
    STUDY_FILE,
    StudyConfig,
    read_study,
    write_study,
)
from knowarm.study.executor import (
    LOG,
    Ended,
    LocalExecutor,
    RunKey,
    Where,
    folder_of,
)
from knowarm.study.ray_executor import RayExecutor
from knowarm.study.status import (
    FAILURE,
    PAUSE,
    RunStatus,
    runs_beside,
    seconds_left,
    study_status,
)
from knowarm.study.worker import STOP, record_failure

RESUMABLE = "checkpoints/latest/state.safetensors"
"""File of a run that a pack with checkpoints has, and others have not."""
POLL_S = 0.5  # time between two looks at the workers [s]
STATUS_S = 2.0  # time between two readings of all run folders [s]
# States in which a free run is worked on.
UNFINISHED = ("waiting", "stalled", "stopped", "trained")

Statuses = Sequence[RunStatus]
OnStatus = Callable[[Statuses], None]
Executor = LocalExecutor | RayExecutor
"""Starts the workers of runs; the driver never starts more than its ``slots``."""


def run_study(
    study: StudyConfig,
    out: Path | str,
    *,
    until_step: int | None = None,
    should_stop: Callable[[], bool] = lambda: False,
    on_status: OnStatus = lambda statuses: None,
) -> list[RunStatus]:
    """Train and evaluate every run of a study that is not done or failed.

    Args:
        study: what to run; the same call again continues it, also after a crash.
        out: the study's folder.
        until_step: save and pause every run at the first update that reaches this step; a later
            call with a larger one, or none, goes on.
        should_stop: called twice a second; true saves every running training and returns.
        on_status: receives the status of all runs at the start, every few seconds and at the end.

    Returns:
        The status of every run at the end.

    Raises:
        UserError: ``out`` holds another study, or a run with another config; it is in use; or the
            machine is too small for one run.
    """
    out = Path(out)
    if until_step is not None and until_step < 1:
        raise UserError(f"until_step must be at least 1, got {until_step}.")
    check_folder(study, out)
    executor = make_executor(study.where, out)
    try:
        with lock_folder(
            out,
            remedy=f"Wait until it ends, or stop it: {shell_command('study', 'stop', out)}",
        ):
            write_study(study, out)
            # Runs that start from now on can be resumed.
            (out / PACKED).unlink(missing_ok=True)
            (out / STOP).unlink(missing_ok=True)
            (out / PAUSE).unlink(missing_ok=True)
            if until_step is not None:
                (out / PAUSE).write_text(f"{until_step}\n", encoding="utf-8")
            _Driver(study, out, executor, on_status).run(should_stop)
    finally:
        executor.close()
    statuses = study_status(study, out)
    on_status(statuses)
    return statuses


def check_folder(study: StudyConfig, out: Path) -> None:
    """Check that a study can go on in a folder, before anything is written."""
    if (out / STUDY_FILE).exists():
        before = read_study(out)
        if before.name != study.name:
            raise UserError(
                f"{out} holds the study {before.name!r}, not {study.name!r}: choose another folder."
            )
        of_before = {f"{config.name}/{config.seed}" for config in before.runs()}
        lost = sorted(of_before.intersection(runs_beside(study, out)))
        if lost:
            raise UserError(
                f"{out} holds runs that would no longer belong to the study: {', '.join(lost[:3])} "
                f"({len(lost)}). Keep their experiments and seeds, or choose another folder."
            )
    if (out / PACKED).exists():
        unfinished = []
        for status in study_status(study, out):
            is_begun = status.state not in ("waiting", "done")
            if is_begun and not (out / status.name / RESUMABLE).is_file():
                unfinished.append(status.name)
        if unfinished:
            raise UserError(
                f"{out} is an unpacked study, which lacks what resuming "
                f"{', '.join(unfinished[:3])} needs: remove the folders of unfinished runs "
                f"({len(unfinished)}) to start these again, choose another folder, or pack the "
                "study with its checkpoints."
            )
    for config in study.runs():
        folder = RunFolder(run_path(out, config))
        if not folder.config_path.exists():
            continue
        different: dict[str, str] = {}
        with suppress(UserError):  # damaged: this run alone fails
            different = other_fields(RunFolder.open(folder.path), config)
        if different:
            raise UserError(
                f"The run {folder.path} has another config than the study (run | study): "
                f"{'; '.join(different.values())}. Change the study back, or choose another folder."
            )


def retry(out: Path, names: Sequence[str] = ()) -> list[str]:
    """Let failed runs resume with the next `run_study`, or the one that is under way.

    `names` are ``<experiment>/<seed>``, or an experiment for all of its seeds; none for all.

    Returns:
        The runs that had failed.
    """
    statuses = study_status(open_study(out), out)
    runs = {status.name for status in statuses}
    experiments = {status.experiment for status in statuses}
    for name in names:
        if name not in runs and name not in experiments:
            raise unknown_name("run of the study", name, runs)
    cleared = []
    for status in statuses:
        is_named = not names or status.name in names or status.experiment in names
        if status.state == "failed" and is_named:
            (out / status.name / FAILURE).unlink()
            cleared.append(status.name)
    return cleared


def request_stop(out: Path) -> bool:
    """Ask driver and workers of a study to save and end; return whether there is a driver."""
    open_study(out)
    if not is_locked(out):
        return False
    (out / STOP).touch()
    return True


def open_study(out: Path) -> StudyConfig:
    """Read the study that a folder holds."""
    if not (out / STUDY_FILE).is_file():
        raise UserError(
            f"{out} holds no study, no {STUDY_FILE}. Start one: knowarm study run."
        )
    return read_study(out)


def make_executor(where: Where, out: Path) -> Executor:
    """Make the executor of a study in a folder."""
    if where.kind == "ray":
        return RayExecutor(where, out)
    return LocalExecutor(where, out)


class _Driver:
    """One pass over a study: starts runs, seed by seed, until nothing is left to do."""

    def __init__(
        self,
        study: StudyConfig,
        out: Path,
        executor: Executor,
        on_status: OnStatus,
    ) -> None:
        self._study = study
        self._out = out
        self._executor = executor
        self._on_status = on_status
        self._mine: set[RunKey] = set()
        # By run and latest checkpoint.
        self._deaths: Counter[tuple[RunKey, int]] = Counter()

    def run(self, should_stop: Callable[[], bool]) -> None:
        """Work until every run is done or failed, or until asked to stop."""
        stopping = False
        read_at = 0.0
        while True:
            ended = self._executor.ended()
            for run in ended:
                self._take_end(run, stopping)
            if not stopping and (should_stop() or (self._out / STOP).exists()):
                stopping = True
                self._executor.stop()
            if ended or time.monotonic() - read_at > STATUS_S:
                statuses = study_status(self._study, self._out)
                read_at = time.monotonic()
                self._on_status(statuses)
                if not stopping:
                    self._start(statuses)
                if not self._mine and (stopping or not self._is_left(statuses)):
                    return
            time.sleep(POLL_S)

    def _start(self, statuses: Statuses) -> None:
        """Fill the free slots in the study's order; leave runs that others hold."""
        waiting = [
            status
            for status in statuses
            if status.run not in self._mine and self._is_free(status)
        ]
        if self._study.order == "seeds":  # otherwise they are in the order of the study
            left = seconds_left(statuses)
            seeds = self._study.all_seeds()

            def order(status: RunStatus) -> tuple[int, float]:
                # Without a known rate, the number of steps orders them.
                length = left.get(status.run, float(status.steps_left))
                return seeds.index(status.seed), -length

            waiting.sort(key=order)
        for status in waiting[: max(0, self._executor.slots - len(self._mine))]:
            self._executor.start(status.run)
            self._mine.add(status.run)

    def _is_free(self, status: RunStatus) -> bool:
        """Return whether a run is to be worked on, and nobody does."""
        return status.state in UNFINISHED and not is_locked(self._out / status.name)

    def _is_left(self, statuses: Statuses) -> bool:
        """Return whether a run is to be worked on, or others do."""
        return any(
            status.state == "running" or self._is_free(status) for status in statuses
        )

    def _take_end(self, end: Ended, stopping: bool) -> None:
        """Take note of a worker's end; a killed one is started again, an error is a failure."""
        run, problem, killed = end
        self._mine.discard(run)
        if problem is None or stopping:
            return
        path = folder_of(self._out, run)
        if not killed:
            record_failure(path, f"{problem}; see {path / LOG}")
            return
        step = RunFolder(path).checkpoint_fact("step", -1)
        self._deaths[run, step] += 1
        count = self._deaths[run, step]
        if count > self._study.where.retries:
            del self._deaths[run, step]  # `retry` starts the count again
            since = f"{count} times since step {max(step, 0):,}"
            record_failure(path, f"{problem}, {since}; out of memory?")
