"""``knowarm study``: tables of runs; ``knowarm report``: one page that compares runs."""

import os
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from rich.console import Group
from rich.live import Live
from rich.table import Table
from rich.text import Text
from tyro.conf import Positional, arg

from knowarm.cli.tables import (
    FilePath,
    FolderPath,
    TableCommand,
    Values,
    counted,
    lay_out,
    make_console,
    print_table,
)
from knowarm.errors import printable, shell_command
from knowarm.experiment.run_lock import StopRequest
from knowarm.reading import read_json, read_text
from knowarm.report import write_figure, write_report
from knowarm.report.figure import Kind
from knowarm.study.config import SHIPPED, STUDY_FILE, StudyConfig, read_study
from knowarm.study.driver import OnStatus, open_study, request_stop, retry, run_study
from knowarm.study.executor import RunKey
from knowarm.study.pack import SUFFIX, Part, pack_study, unpack_study
from knowarm.study.status import (
    RunStatus,
    runs_beside,
    seconds_left,
    study_status,
    totals,
)

EVERY_S = 60.0  # time between two plain lines without a change
PAUSED = ("stalled", "stopped", "paused")  # begun, and not going on
STYLES = {
    "running": "cyan",
    "failed": "red",
    "done": "green",
    **dict.fromkeys(PAUSED, "yellow"),
}
BAD = ("failed", "damaged")  # states that need an action of the user


@contextmanager
def study_progress(study: StudyConfig) -> Iterator[OnStatus]:
    """Display a running study: as a table on a terminal, else as a line per change."""
    console = make_console()
    if console.is_terminal:
        with Live(console=console, auto_refresh=False) as live:
            yield lambda statuses: live.update(
                Group(*status_tables(study, statuses, console.width)), refresh=True
            )
        return
    states: dict[RunKey, str] = {}
    last_line = -EVERY_S

    def show(statuses: Sequence[RunStatus]) -> None:
        nonlocal last_line
        has_changed = False
        for status in statuses:
            before = states.get(status.run)
            states[status.run] = status.state
            if before == status.state:
                continue
            has_changed = True
            if before is not None or status.state != "waiting":
                print(state_line(status), flush=True)
        if has_changed or time.monotonic() - last_line >= EVERY_S:
            last_line = time.monotonic()
            print(summary_line(study, statuses), flush=True)

    yield show


def status_tables(
    study: StudyConfig,
    statuses: Sequence[RunStatus],
    room: int,
) -> list[Table | Text]:
    """Return title, table and summary: one row per experiment and one column per seed."""
    left = seconds_left(statuses)
    cells = {status.run: _cell(status, left) for status in statuses}
    seeds = study.all_seeds()
    rows = []
    for experiment in study.cells():
        row = [cells.get((experiment, seed), Text("")) for seed in seeds]
        rows.append([Text(experiment), *row])
    columns = ["experiment", *(f"seed {seed}" for seed in seeds)]
    title = Text(f"Study {study.name}", style="bold")
    return [title, *lay_out(columns, rows, room), Text(summary_line(study, statuses))]


def _cell(status: RunStatus, left: dict[RunKey, float]) -> Text:
    words: list[str] = [status.state]
    if status.state in ("running", "failed", *PAUSED):
        words.append(f"{100 * status.step / status.total_steps:.0f} %")
    if status.success is not None:
        words.append(f"success {100 * status.success:.0f} %")
    if status.state == "running":
        if status.steps_per_s:
            words.append(f"{status.steps_per_s:,.0f}/s")
        if status.run in left:
            words.append(f"{left[status.run] / 60:.0f} min left")
    return Text(" · ".join(words), style=STYLES.get(status.state, ""))


def state_line(status: RunStatus) -> str:
    """Return the state of a run and the reason for it, if there is one."""
    line = f"{status.name} {status.state}"
    if status.detail:
        line += f": {printable(status.detail)}"
    return line


def summary_line(study: StudyConfig, statuses: Sequence[RunStatus]) -> str:
    """Return the number of runs per state, and the cost so far and to go."""
    counts, spent, to_go = totals(statuses, study.where.cores).values()
    states = ", ".join(f"{count} {state}" for state, count in counts.items())
    line = f"{len(statuses)} runs: {states}. Core hours of training: {spent:.2f}"
    if to_go is not None:
        line += f", {to_go:.2f} to go"
    return f"{line}."


Number = Annotated[int | None, arg(metavar="N")]


@dataclass(frozen=True, kw_only=True)
class FolderCommand:
    """Command on the folder of a study."""

    folder: Annotated[Path, Positional, arg(metavar="DIR")]
    """Folder of the study."""


@dataclass(frozen=True, kw_only=True)
class StudyShow:
    """Print a study: its TOML file and its runs."""

    study: Annotated[str | None, Positional, arg(metavar="[STUDY]")] = None
    """Name of a shipped study, TOML file or folder of a study. Default: list the shipped ones."""
    of: FilePath = None
    """Of controls: the study whose agents they control. Of a draw: the study that it repeats."""

    def run(self) -> None:
        """Print it."""
        if self.study is None:
            studies = map(read_study, SHIPPED)
            rows = [[study.name, len(study.runs()), study.about] for study in studies]
            print_table("Studies", ["study", "runs", "about"], rows)
            return
        study = read_study(self.study, of=self.of)
        file = SHIPPED.get(self.study, Path(self.study))
        if file.is_file():
            print(read_text(file, remedy="Restore the file."))
        runs = study.runs()
        steps = {config.name: config.total_steps for config in runs}
        seeds = ", ".join(map(str, study.all_seeds()))
        title = f"Study {study.name}: {len(runs)} runs, seeds {seeds}"
        print_table(title, ["experiment", "steps"], steps.items())
        for evaluation in study.evaluations:
            seeds = counted(evaluation.seeds, "seed")
            print(
                f"Evaluated on {evaluation.episodes:,} episodes of {seeds}: {evaluation.folder}"
            )


@dataclass(frozen=True, kw_only=True)
class StudyRun:
    """Train and evaluate every run of a study; the same command continues after any end."""

    study: Annotated[str, Positional, arg(metavar="STUDY")]
    """Name of a shipped study, TOML file or folder of a study."""
    out: FolderPath = None
    """Folder of the study. Default: runs/NAME, or the given folder."""
    of: FilePath = None
    """Of controls: the study whose agents they control. Of a draw: the study that it repeats."""
    seeds: Annotated[tuple[int, ...], arg(metavar="SEED...")] = ()
    """Training seeds instead of the study's."""
    executor: Literal["local", "ray"] | None = None
    """This machine (local), or the nodes of a Ray cluster (ray). Default: the study's, local."""
    at_once: Number = None
    """Runs at once. Default: as many as cores and memory hold."""
    cores: Number = None
    """Cores of each run."""
    until_step: Number = None
    """Save and pause every run at step N; a later command with a larger N, or none, goes on."""

    def run(self) -> None:
        """Run the study."""
        study = read_study(self.study, of=self.of)
        chosen = {"kind": self.executor, "at_once": self.at_once, "cores": self.cores}
        changes: dict[str, Any] = {
            name: v for name, v in chosen.items() if v is not None
        }
        where = replace(study.where, **changes)
        study = replace(study, where=where, seeds=self.seeds or study.seeds)
        out = self.out
        if out is None:
            folder = Path(self.study)
            is_folder = self.study not in SHIPPED and (folder / STUDY_FILE).is_file()
            out = folder if is_folder else Path("runs") / study.name
        with StopRequest() as should_stop, study_progress(study) as progress:
            statuses = run_study(
                study,
                out,
                until_step=self.until_step,
                should_stop=should_stop,
                on_status=progress,
            )
        for status in statuses:
            if status.state in BAD:
                print(state_line(status))
        if any(status.step for status in statuses):
            report = write_report([out], out / "report.html")
            print(f"Wrote {report}: open it in a browser.")
        states = {status.state for status in statuses}
        if states <= {"done"}:
            print(f"Complete: {out}")
            return
        if states <= {"done", "paused"}:
            print(f"Paused at step {self.until_step:,} of each run: {out}")
            print(
                "Run the same command with a larger --until-step, or without, to continue."
            )
            return
        if "failed" in states:
            print(
                "To let failed runs resume, run the same command after: "
                f"{shell_command('study', 'retry', out)}"
            )
        if "damaged" in states:
            print("Repair or remove what is damaged, then run the same command again.")
        if states.isdisjoint(BAD):
            print("Stopped and saved. Run the same command again to continue.")
        sys.exit(1)


PROGRESS = ("run", "state", "steps", "of", "best return", "at step", "steps/s")


@dataclass(frozen=True, kw_only=True)
class Status(FolderCommand, TableCommand):
    """Show the state of every run of a study."""

    def result(self) -> Values:
        """Print the table and the reasons of failures."""
        study = open_study(self.folder)
        statuses = study_status(study, self.folder)
        console = make_console()
        for table in status_tables(study, statuses, console.width):
            console.print(table, crop=False, soft_wrap=isinstance(table, Text))
        rows = []
        for status in statuses:
            if status.step:
                row = [status.name, status.state, status.step, status.total_steps]
                speed = status.step / status.seconds if status.seconds else None
                rows.append([*row, status.best_return, status.best_step, speed])
        if rows:
            print_table("Runs", PROGRESS, rows)
        for status in statuses:
            if status.detail and status.state in (*BAD, *PAUSED):
                print(state_line(status))
        return {
            "study": study.name,
            **totals(statuses, study.where.cores),
            "runs": list(map(asdict, statuses)),
        }


@dataclass(frozen=True, kw_only=True)
class Retry(FolderCommand):
    """Let failed runs resume."""

    runs: Positional[Annotated[tuple[str, ...], arg(metavar="[RUN...]")]] = ()
    """EXPERIMENT/SEED or EXPERIMENT. Default: every failed run."""

    def run(self) -> None:
        """Forget the failures."""
        names = retry(self.folder, self.runs)
        for name in names:
            print(f"{name} will resume.")
        if names:
            print(f"Continue with: {shell_command('study', 'run', self.folder)}")
        else:
            print("No run has failed.")


@dataclass(frozen=True, kw_only=True)
class Stop(FolderCommand):
    """Ask a running study to save its runs and end."""

    def run(self) -> None:
        """Leave the request in the folder."""
        if request_stop(self.folder):
            print("Asked to stop: running trainings save a checkpoint and end.")
        else:
            print(f"Nothing is running in {self.folder}.")


@dataclass(frozen=True, kw_only=True)
class Pack(FolderCommand):
    """Write a study to one file to archive or share."""

    out: FilePath = None
    """The file. Default: DIR.tar.xz."""
    leave_out: tuple[Part, ...] = ()
    """Parts to leave out, to make it smaller."""
    with_checkpoints: bool = False
    """Add the latest checkpoint of each unfinished run, with which it resumes elsewhere."""

    def run(self) -> None:
        """Write the file."""
        folder = self.folder if self.folder.name.strip(".") else self.folder.resolve()
        file = self.out or folder.with_name(folder.name + SUFFIX)
        count = pack_study(
            self.folder,
            file,
            leave_out=self.leave_out,
            with_checkpoints=self.with_checkpoints,
        )
        for name in runs_beside(open_study(self.folder), self.folder):
            print(f"Left out: {name} is no run of the study.")
        print(f"Wrote {file}: {count:,} files, {file.stat().st_size / 2**20:.1f} MiB")


@dataclass(frozen=True, kw_only=True)
class Unpack:
    """Unpack a study, and compare every file with its digest."""

    file: Annotated[Path, Positional, arg(metavar="FILE")]
    """What `knowarm study pack` wrote."""
    out: FolderPath = None
    """New folder. Default: the file's name without .tar.xz."""

    def run(self) -> None:
        """Write the folder."""
        out = self.out or self.file.with_name(self.file.name.removesuffix(SUFFIX))
        report = shell_command("report", out, "--out", out / "report.html")
        print(f"Unpacked: {unpack_study(self.file, out)}. Report: {report}")


@dataclass(frozen=True, kw_only=True)
class RunsCommand:
    """Command on runs."""

    runs: Annotated[
        tuple[Path, ...],
        Positional,
        arg(metavar="RUN...", help_behavior_hint="(required)"),
    ]
    """Run folders, or folders that contain them at any depth."""


@dataclass(frozen=True, kw_only=True)
class Report(RunsCommand, TableCommand):
    """Write one self-contained HTML report, and its numbers as JSON and CSV."""

    out: Path = Path("runs/report.html")
    """HTML file; the JSON and CSV files are written to the same folder."""

    def result(self) -> Values:
        """Write the report and return its numbers."""
        path = write_report(self.runs, self.out)
        values = read_json(path.with_suffix(".json"))
        for problem in values["problems"]:
            where = os.path.relpath(path.parent / problem["path"])
            print(f"Note: {where}, {problem['what']}, {problem['done']}")
        print(f"Wrote {path}: open it in a browser.")
        return values


@dataclass(frozen=True, kw_only=True)
class PaperFigure(RunsCommand):
    """Write a figure or table of runs for a paper, with the verdict of their report as caption."""

    out: Path = Path("runs/figure.pdf")
    """A drawing (.pdf, .svg or .png), or a table (.tex or .md)."""
    kind: Kind | None = None
    """What is drawn: success over the steps, success after training with intervals, or film
    strips. Default: curves."""
    caption: bool = True
    """Write the caption below the drawing."""

    def run(self) -> None:
        """Write the file and print its caption."""
        sentence = write_figure(
            self.runs, self.out, kind=self.kind, caption=self.caption
        )
        print(printable(f"Caption: {sentence}"))
        print(f"Wrote {self.out}")


COMMANDS: dict[str, type] = {
    "show": StudyShow,
    "run": StudyRun,
    "status": Status,
    "retry": Retry,
    "stop": Stop,
    "pack": Pack,
    "unpack": Unpack,
}
"""Commands of the group, by name."""
