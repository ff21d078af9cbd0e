"""Driver of a study: starts workers until every run is done or failed; keeps no state of its own.

Everything it knows comes from the run folders, so it can be killed and started again at any time.
"""

import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from knowarm.errors import UserError, unknown_name
from knowarm.experiment.run import other_fields, run_path
from knowarm.experiment.run_folder import RunFolder
from knowarm.experiment.run_lock import is_locked, lock_folder
from knowarm.study.config import PACKED, STUDY_FILE, StudyConfig, read_study, write_study
from knowarm.study.executor import LOG, Ended, Executor, LocalExecutor, RunKey, Where
from knowarm.study.ray_executor import RayExecutor
from knowarm.study.status import FAILURE, PAUSE, RunStatus, runs_beside, seconds_left, study_status
from knowarm.study.worker import STOP, record_failure

RESUMABLE = "checkpoints/latest/state.safetensors"
"""File of a run that a pack with checkpoints has, and others have not."""
POLL_S = 0.5  # time between two looks at the workers [s]
STATUS_S = 2.0  # time between two readings of all run folders [s]
UNFINISHED = ("waiting", "stalled", "stopped", "trained")  # states in which a free run is worked on

OnStatus = Callable[[Sequence[RunStatus]], None]


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
        with lock_folder(out, remedy="Wait until it ends, or stop it: knowarm study stop."):
            write_study(study, out)
            (out / PACKED).unlink(missing_ok=True)  # runs that start from now on can be resumed
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
            found = f"holds the study {before.name!r}, not {study.name!r}"
            raise UserError(f"{out} {found}: choose another folder.")
        lost = sorted({*runs_beside(study, out)} & {f"{c.name}/{c.seed}" for c in before.runs()})
        if lost:
            raise UserError(
                f"{out} holds runs that would no longer belong to the study: {', '.join(lost[:3])} "
                f"({len(lost)}). Keep their experiments and seeds, or choose another folder."
            )
    if (out / PACKED).exists():
        statuses = [each for each in study_status(study, out) if each.state != "waiting"]
        begun = [
            each.name
            for each in statuses
            if each.state != "done" and not (out / each.name / RESUMABLE).is_file()
        ]
        if begun:
            raise UserError(
                f"{out} is an unpacked study, which lacks what resuming {', '.join(begun[:3])} "
                f"needs: remove the folders of unfinished runs ({len(begun)}) to start these "
                "again, choose another folder, or pack the study with its checkpoints."
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
    known = {each.name for each in statuses}
    for name in names:
        if name not in known and name not in {each.experiment for each in statuses}:
            raise unknown_name("run of the study", name, known)
    cleared = []
    for status in statuses:
        if status.state == "failed" and (not names or {status.name, status.experiment} & {*names}):
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
        raise UserError(f"{out} holds no study, no {STUDY_FILE}. Start one: knowarm study run.")
    return read_study(out)


def make_executor(where: Where, out: Path) -> Executor:
    """Make the executor of a study in a folder."""
    return (RayExecutor if where.kind == "ray" else LocalExecutor)(where, out)


class _Driver:
    """One pass over a study: starts runs, seed by seed, until nothing is left to do."""

    def __init__(
        self, study: StudyConfig, out: Path, executor: Executor, on_status: OnStatus
    ) -> None:
        self._study, self._out, self._executor = study, out, executor
        self._on_status = on_status
        self._mine: set[RunKey] = set()
        self._deaths: Counter[tuple[RunKey, int]] = Counter()  # by run and latest checkpoint

    def run(self, should_stop: Callable[[], bool]) -> None:
        """Work until every run is done or failed, or until asked to stop."""
        stopping, read = False, 0.0
        while True:
            ended = self._executor.ended()
            for run in ended:
                self._take_end(run, stopping)
            if not stopping and (should_stop() or (self._out / STOP).exists()):
                stopping = True
                self._executor.stop()
            if ended or time.monotonic() - read > STATUS_S:
                statuses = study_status(self._study, self._out)
                read = time.monotonic()
                self._on_status(statuses)
                if not stopping:
                    self._start(statuses)
                others = any(each.state == "running" for each in statuses)
                free = (each for each in statuses if each.state in UNFINISHED)
                left = any(not is_locked(self._out / each.name) for each in free)
                if not self._mine and (stopping or not (left or others)):
                    return
            time.sleep(POLL_S)

    def _start(self, statuses: Sequence[RunStatus]) -> None:
        """Fill the free slots in the study's order; leave runs that others hold."""
        left = seconds_left(statuses)
        free = [s for s in statuses if s.state in UNFINISHED and s.run not in self._mine]
        todo = [s for s in free if not is_locked(self._out / s.name)]
        # Without a known rate, the number of steps orders them.
        length = {each.run: left.get(each.run, float(each.steps_left)) for each in todo}
        if self._study.order == "seeds":  # otherwise they are in the order of the study
            seeds = self._study.all_seeds()
            todo.sort(key=lambda each: (seeds.index(each.run[1]), -length[each.run]))
        for status in todo[: max(0, self._executor.slots - len(self._mine))]:
            self._executor.start(status.run)
            self._mine.add(status.run)

    def _take_end(self, end: Ended, stopping: bool) -> None:
        """Take note of a worker's end; a killed one is started again, an error is a failure."""
        run, problem, killed = end
        self._mine.discard(run)
        if problem is None or stopping:
            return
        path = self._out / run[0] / str(run[1])
        if not killed:
            record_failure(path, f"{problem}; see {path / LOG}")
            return
        self._deaths[run, step := RunFolder(path).checkpoint_fact("step", -1)] += 1
        if (count := self._deaths[run, step]) > self._study.where.retries:
            del self._deaths[run, step]  # `retry` starts the count again
            reason = f"{problem}, {count} times since step {max(step, 0):,}; out of memory?"
            record_failure(path, reason)
