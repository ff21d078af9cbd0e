"""Run folder reader of reports."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np

from knowarm.config import to_dict
from knowarm.errors import UserError, shell_command
from knowarm.experiment.csv_log import number_in, read_csv
from knowarm.experiment.provenance import Provenance
from knowarm.experiment.run_folder import RunFolder
from knowarm.experiment.run_inputs import input_content, with_inputs
from knowarm.experiment.summary import Summary
from knowarm.reading import one_line, read_bytes
from knowarm.report.model import (
    Curve,
    Evaluation,
    FolderProblem,
    Problems,
    RunData,
    Runs,
)

GIVE = "Give run folders such as runs/irb120-full-fast/0."


def read_folders(paths: Sequence[Path]) -> tuple[Runs, Problems]:
    """Read run folders, at any depth."""
    problems: Problems = []
    runs = []
    for path in _run_folders(paths, problems):
        with _attempt(path, "left out", problems):
            runs.append(read_run(path, problems))
    if not runs:
        reasons = [f"{problem.path}: {problem.what}" for problem in problems[:3]]
        reason = "; ".join(reasons) or "no folder was given"
        raise UserError(f"Nothing to report: {reason}. {GIVE}")
    return runs, problems


def read_run(path: Path, problems: Problems) -> RunData:
    """Read one run folder; defects of files other than its config become ``problems``."""
    folder = RunFolder.open(path)
    config = folder.experiment()
    provenance = Provenance()
    with _attempt(path, "kept; versions and parameters unknown", problems):
        provenance = folder.provenance()
    evaluations = {}
    for evaluated in sorted(filter(Path.is_dir, (path / "evaluation").glob("*"))):
        with _attempt(evaluated, "the evaluation is left out", problems):
            evaluations[evaluated.name] = Evaluation(evaluated, Summary.read(evaluated))
    run = RunData(
        path=path,
        config=config,
        settings=with_inputs(to_dict(config), input_content),
        provenance=provenance,
        interim=read_curve(folder.evaluations_path, problems),
        metrics=read_curve(folder.metrics_path, problems),
        evaluations=evaluations,
    )

    def report(what: str, done: str) -> None:
        problems.append(FolderProblem(path, what, f"kept; {done}"))

    if not run.interim:
        report("no interim evaluations", "missing from the learning curves")
    if not evaluations:
        report("no post-training evaluation", "missing from the tables of results")
    if run.best_step == 0 and evaluations:
        report(
            "its best interim evaluation is that of step 0",
            "the evaluated network is untrained",
        )
    if 0 < run.steps_done < 0.98 * config.total_steps:
        what = f"stopped after {run.steps_done / config.total_steps:.0%} of its steps"
        rule = config.stop_when
        if rule and folder.ended_early_at(rule):
            what += f", as its stop_when says (success {rule.success:.0%} {rule.evaluations}x)"
            report(what, "censored at its end, its last success extended")
            return replace(run, ended_early=True)
        report(what, "censored at its end, left out of means over longer trainings")
    return run


def read_curve(path: Path, problems: Problems) -> Curve:
    """Read the columns of a CSV log; empty if the file is missing or has no rows.

    Damaged rows and cells are left out and reported. Of two rows of a step the later one is kept.
    """
    if not path.is_file():
        return {}
    try:
        rows = read_csv(path)
        is_truncated = read_bytes(path)[-1:] not in (b"", b"\n")
    except (OSError, UserError) as error:
        problems.append(FolderProblem(path, f"cannot be read ({error})", "left out"))
        return {}
    columns = list(filter(None, dict.fromkeys(chain.from_iterable(rows))))
    values: dict[float, list[float | None]] = {}
    damaged = 0
    for row in rows:
        numbers = {name: number_in(row, name) for name in columns}
        missing = {row.get(name) for name in columns if numbers[name] is None}
        step = number_in(row, "step")
        if step is None or step < 0:
            missing.add(None)
        else:
            values[step] = list(numbers.values())
        damaged += not missing <= {"", "nan"}
    if is_truncated:
        problems.append(
            FolderProblem(path, "last line truncated", "the line is left out")
        )
    if damaged:
        what = f"{damaged} damaged rows"
        problems.append(FolderProblem(path, what, "the rows or cells are left out"))
    if not values:
        return {}
    table = np.array([values[step] for step in sorted(values)], np.float64)
    return {
        name: column
        for name, column in zip(columns, table.T, strict=True)
        if np.isfinite(column).any()  # one without any number is as good as missing
    }


@contextmanager
def _attempt(path: Path, done: str, problems: Problems) -> Iterator[None]:
    """Report whatever damaged content of a file or folder raises as one of the problems."""
    try:
        yield
    except UserError as error:
        problems.append(FolderProblem(path, str(error), done))
    except Exception as error:
        problems.append(FolderProblem(path, f"damaged: {one_line(error)}", done))


def _run_folders(paths: Sequence[Path], problems: Problems) -> list[Path]:
    folders: dict[Path, Path] = {}
    for path in paths:
        configs = sorted(path.rglob("config.json"))
        if (path / "config.json").is_file():
            configs = [path / "config.json"]
        if not configs:
            what = "does not exist"
            if path.is_file():
                unpack = shell_command("study", "unpack", path)
                what = f"is no folder; unpack a packed study first: {unpack}"
            elif path.exists():
                what = "holds no run folder"
            problems.append(FolderProblem(path, what, "left out"))
        for config in configs:
            folder = config.parent
            folders.setdefault(folder.resolve(), folder)  # given twice, it counts once
    return list(folders.values())
