"""``knowarm study``: tables of runs, on this machine or a cluster."""

import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console

from knowarm.cli.study_table import StudyProgress, status_table, summary_line
from knowarm.cli.tables import FilePath, check_json_path, print_table, write_json_table
from knowarm.config import replace as replace_fields
from knowarm.errors import UserError, unknown_name
from knowarm.experiment.stop_request import StopRequest
from knowarm.report import write_report
from knowarm.study.config import FILE, SHIPPED, StudyConfig, read_study
from knowarm.study.driver import check_folder, open_study, request_stop, retry, run_study
from knowarm.study.estimate import estimate
from knowarm.study.executors import EXECUTORS
from knowarm.study.pack import SUFFIX, Part, pack_study, unpack_study
from knowarm.study.status import RunStatus, study_status, totals

Source = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="STUDY")]
Folder = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]
Option = Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="")]
Number = Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="")]


@dataclass(frozen=True, kw_only=True)
class Show:
    """Print a study: its TOML file and its runs."""

    study: Annotated[
        str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[STUDY]", help_behavior_hint="")
    ] = None
    """Name of a shipped study, TOML file or folder of a study. Default: list the shipped ones."""
    of: FilePath = None
    """For the controls: the study whose agents they control."""

    def run(self) -> None:
        """Print it."""
        if self.study is None:
            rows = [
                [name, len(read_study(name).runs()), read_study(name).about] for name in SHIPPED
            ]
            print_table("Studies", ["study", "runs", "about"], rows)
            return
        study = read_study(self.study, of=self.of)
        file = SHIPPED.get(self.study, Path(self.study))
        if file.is_file():
            print(file.read_text())
        experiments = {config.name: config for config in study.runs()}
        print_table(
            f"Study {study.name}: {len(study.runs())} runs, seeds "
            f"{', '.join(map(str, study.seeds))}",
            ["experiment", "steps"],
            [[name, config.total_steps] for name, config in experiments.items()],
        )
        for evaluation in study.evaluations:
            print(
                f"Evaluated on {evaluation.episodes:,} episodes of {evaluation.seeds} evaluation "
                f"seeds: {evaluation.folder}"
            )


@dataclass(frozen=True, kw_only=True)
class Run:
    """Train and evaluate every run of a study; the same command continues after any end."""

    study: Source
    """Name of a shipped study, TOML file or folder of a study."""
    out: FilePath = None
    """Folder of the study. Default: runs/NAME, or the given folder."""
    of: FilePath = None
    """For the controls: the study whose agents they control."""
    seeds: Annotated[tuple[int, ...], tyro.conf.arg(metavar="SEED...", help_behavior_hint="")] = ()
    """Training seeds instead of the study's."""
    where: Option = None
    """What executes the runs. Default: as in the study."""
    at_once: Number = None
    """Runs at once on this machine. Default: as many as its cores and memory hold."""
    cores: Number = None
    """Cores of each run."""
    address: Annotated[str | None, tyro.conf.arg(metavar="HOST:PORT", help_behavior_hint="")] = None
    """Head node of a Ray cluster, for --where ray. Default: a cluster on this machine."""
    mirrors: Annotated[
        tuple[str, ...], tyro.conf.arg(metavar="NAME...", help_behavior_hint="")
    ] = ()
    """Tracking services that receive the curves as well: wandb, mlflow."""
    dry_run: bool = False
    """Only estimate the cost, from a short measurement of every experiment on this machine."""

    def run(self) -> None:
        """Run the study, or estimate its cost."""
        study = self._study()
        is_folder = (Path(self.study) / FILE).is_file()
        out = self.out or (Path(self.study) if is_folder else Path("runs") / study.name)
        if self.dry_run:
            _print_estimate(study, out)
            return
        with StopRequest() as should_stop, StudyProgress(study) as progress:
            statuses = run_study(study, out, should_stop=should_stop, on_status=progress)
        failed = [each for each in statuses if each.state == "failed"]
        for each in failed:
            print(f"{each.experiment}/{each.seed} failed: {each.detail}")
        if any(each.step for each in statuses):
            print(f"Wrote {write_report([out], out / 'report.html')}: open it in a browser.")
        if failed:
            print(f"Let them resume with: knowarm study retry {out}, then the same command.")
        if all(each.state == "done" for each in statuses):
            print(f"Complete: {out}")
            return
        if not failed:
            print("Stopped and saved. Run the same command again to continue.")
        sys.exit(1)

    def _study(self) -> StudyConfig:
        study = read_study(self.study, of=self.of)
        if self.seeds:
            study = replace(study, seeds=self.seeds)
        if self.mirrors:
            study = replace(study, mirrors=self.mirrors)
        where = study.where
        if self.where is not None and self.where != where.kind:
            if self.where not in EXECUTORS:
                raise unknown_name("executor", self.where, EXECUTORS)
            where = EXECUTORS[self.where].default
        chosen: dict[str, Any] = {
            "at_once": self.at_once,
            "cores": self.cores,
            "address": self.address,
        }
        chosen = {name: value for name, value in chosen.items() if value is not None}
        return replace(study, where=replace_fields(where, chosen, where="where"))


def _print_estimate(study: StudyConfig, out: Path) -> None:
    """Measure and print what a study will cost."""
    check_folder(study, out)
    print(f"Measuring {len(study.cells())} experiments ...", flush=True)
    found = estimate(study, out)
    print_table(
        f"Study {study.name}, estimated on this machine",
        ["experiment", "runs to go", "steps/s", "core hours"],
        [[row.experiment, row.runs, row.steps_per_s, row.core_hours] for row in found.rows],
    )
    print(
        f"{found.core_hours:.2f} core hours; {found.hours:.2f} hours with {found.slots} runs at "
        f"once; up to {found.disk_gib:.1f} GiB. Nothing was started."
    )


@dataclass(frozen=True, kw_only=True)
class Status:
    """Show the state of every run of a study."""

    folder: Folder
    """Folder of the study."""
    json: FilePath = None
    """Also write the states to this JSON file."""

    def run(self) -> None:
        """Print the table and the reasons of failures."""
        check_json_path(self.json)
        study = open_study(self.folder)
        statuses = study_status(study, self.folder)
        Console(highlight=False).print(status_table(study, statuses))
        for each in statuses:
            if each.detail and each.state in ("failed", "stalled"):
                print(f"{each.experiment}/{each.seed} {each.state}: {each.detail}")
        values = {"study": study.name, **totals(statuses, study.where.cores)}
        write_json_table(self.json, values | {"runs": [asdict(each) for each in statuses]})


@dataclass(frozen=True, kw_only=True)
class Retry:
    """Let failed runs resume."""

    folder: Folder
    """Folder of the study."""
    runs: Annotated[
        tuple[str, ...],
        tyro.conf.Positional,
        tyro.conf.arg(metavar="[RUN...]", help_behavior_hint=""),
    ] = ()
    """EXPERIMENT/SEED or EXPERIMENT. Default: every failed run."""

    def run(self) -> None:
        """Forget the failures."""
        cleared = retry(self.folder, self.runs)
        for name in cleared:
            print(f"{name} will resume.")
        print(
            f"Continue with: knowarm study run {self.folder}" if cleared else "No run has failed."
        )


@dataclass(frozen=True, kw_only=True)
class Stop:
    """Ask a running study to save its runs and end."""

    folder: Folder
    """Folder of the study."""

    def run(self) -> None:
        """Leave the request in the folder."""
        if request_stop(self.folder):
            print("Asked to stop: running trainings save a checkpoint and end.")
        else:
            print(f"Nothing is running in {self.folder}.")


@dataclass(frozen=True, kw_only=True)
class Pack:
    """Write a study to one file to archive or share."""

    folder: Folder
    """Folder of the study."""
    out: FilePath = None
    """The file. Default: DIR.tar.gz."""
    leave_out: tuple[Part, ...] = ()
    """Parts to leave out, to make it smaller."""

    def run(self) -> None:
        """Write the file."""
        file = self.out or self.folder.with_name(self.folder.name + SUFFIX)
        count = pack_study(self.folder, file, leave_out=self.leave_out)
        print(f"Wrote {file}: {count:,} files, {file.stat().st_size / 2**20:.1f} MiB")


@dataclass(frozen=True, kw_only=True)
class Unpack:
    """Unpack a study, and compare every file with its digest."""

    file: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    """What `knowarm study pack` wrote."""
    out: FilePath = None
    """New folder. Default: the file's name without .tar.gz."""

    def run(self) -> None:
        """Write the folder."""
        out = self.out or self.file.with_name(self.file.name.removesuffix(SUFFIX))
        print(f"Unpacked: {unpack_study(self.file, out)}. Report: knowarm study report {out}")


@dataclass(frozen=True, kw_only=True)
class Report:
    """Write the report of a study, also of one that is not complete, and list what is missing."""

    folder: Folder
    """Folder of the study."""
    out: FilePath = None
    """HTML file. Default: report.html in the folder of the study."""

    def run(self) -> None:
        """Write the report."""
        study = open_study(self.folder)
        statuses = study_status(study, self.folder)
        missing: list[RunStatus] = [each for each in statuses if each.state != "done"]
        if all(each.state == "waiting" for each in statuses):
            raise UserError(f"No run of {self.folder} has started: there is nothing to report.")
        path = write_report([self.folder], self.out or self.folder / "report.html")
        for each in missing:
            share = f"{each.step:,} of {each.total_steps:,} steps"
            print(f"Missing: {each.experiment}/{each.seed} is {each.state} ({share})")
        print(f"Wrote {path}. {summary_line(study, statuses)}")


COMMANDS: dict[str, type] = {
    "show": Show,
    "run": Run,
    "status": Status,
    "retry": Retry,
    "stop": Stop,
    "report": Report,
    "pack": Pack,
    "unpack": Unpack,
}
"""Commands of the group, by name."""
