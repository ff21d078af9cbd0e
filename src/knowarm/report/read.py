"""Run folder reader of reports: runs and evaluations as far as they can be read."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from knowarm.errors import UserError
from knowarm.experiment.config import StopWhen
from knowarm.experiment.migration import migrate_evaluation
from knowarm.experiment.run_folder import RunFolder, read_csv
from knowarm.reading import one_line, read_json
from knowarm.report.study import Curve, Evaluation, Problem, Reference, Run

NEEDED_NUMBERS = ("episodes", "return_mean", "success", "accuracy")
NEEDED_CONFIG = {"agent": str, "seed": int, "env": dict, "algorithm": dict}


def read_folders(
    paths: Sequence[Path], references: Mapping[str, Path] | None = None
) -> tuple[list[Run], list[Reference], list[Problem]]:
    """Read run folders and evaluations.

    Args:
        paths: run folders, or folders that hold them at any depth.
        references: evaluation folders of policies that have no run, by name.

    Raises:
        UserError: the paths hold nothing that can be reported.
    """
    problems: list[Problem] = []
    runs = []
    for path in _run_folders(paths, problems):
        try:
            run = read_run(path, problems)
        except Exception as error:  # a value of a wrong type in one of its files
            problems.append(Problem(path, f"damaged: {one_line(error)}", "left out"))
            continue
        runs += [run] if run is not None else []
    if not runs:
        reasons = "; ".join(f"{p.path}: {p.what}" for p in problems[:3]) or "no folder was given"
        raise UserError(
            f"Nothing to report: {reasons}. Give run folders such as runs/irb120-full-fast/0."
        )
    known: list[Reference] = []
    for name, path in (references or {}).items():
        try:
            known.append(Reference(name, (read_evaluation(path),)))
        except UserError as error:
            problems.append(Problem(path, str(error), "left out"))
    return runs, known, problems


def read_run(path: Path, problems: list[Problem]) -> Run | None:
    """Read one run folder and append its defects to ``problems``.

    Returns:
        The run, or None if the folder is no run, of another format or without its config.
    """
    try:
        folder = RunFolder.open(path)
        config = folder.config()
    except UserError as error:
        problems.append(Problem(path, str(error), "left out"))
        return None
    if missing := [n for n, kind in NEEDED_CONFIG.items() if not isinstance(config.get(n), kind)]:
        problems.append(Problem(path, f"config.json lacks {', '.join(missing)}", "left out"))
        return None
    try:
        provenance = folder.provenance()
    except UserError as error:
        problems.append(Problem(path, str(error), "kept; versions and parameters unknown"))
        provenance = {}
    evaluations = {}
    for each in sorted(each for each in (path / "evaluation").glob("*") if each.is_dir()):
        try:
            evaluations[each.name] = read_evaluation(each)
        except UserError as error:
            problems.append(Problem(each, str(error), "the evaluation is left out"))
    interim = read_curve(folder.evaluations_path, problems)
    metrics = read_curve(folder.metrics_path, problems)
    run = Run(path, config, provenance, interim, metrics, evaluations)
    for found, what, where in (
        (interim, "no interim evaluations", "learning curves"),
        (evaluations, "no post-training evaluation", "tables of results"),
    ):
        if not found:
            problems.append(Problem(path, what, f"kept; missing from the {where}"))
    total = config.get("total_steps")
    if total and 0 < run.steps_done < 0.98 * total:
        what = f"stopped after {run.steps_done / total:.0%} of its steps"
        if (rule := config.get("stop_when")) and folder.ended_early_at(StopWhen(**rule)):
            success, count = rule["success"], rule["evaluations"]
            what += f", as its stop_when says (success {success:.0%} {count}x)"
        done = "kept; censored at its end, its last success extended"
        problems.append(Problem(path, what, done))
    return run


def read_curve(path: Path, problems: list[Problem]) -> Curve:
    """Read the columns of a CSV log; empty if the file is missing or has no rows.

    A truncated last line, rows without a step and cells that are no numbers are left out and
    reported. Of two rows of the same step, as a resumed run may leave, the later one is kept.
    """
    if not path.is_file():
        return {}
    try:
        rows = read_csv(path)
        is_truncated = path.read_bytes()[-1:] not in (b"", b"\n")
    except (OSError, UserError) as error:
        problems.append(Problem(path, f"cannot be read ({error})", "left out"))
        return {}
    columns = [name for name in dict.fromkeys(name for row in rows for name in row) if name]
    values: dict[float, list[float]] = {}
    damaged = 0
    for row in rows:
        numbers = {name: _number(row.get(name)) for name in columns}
        step = numbers.get("step")
        if step is None or np.isnan(step):
            damaged += 1
            continue
        damaged += None in numbers.values()
        values[step] = [np.nan if number is None else number for number in numbers.values()]
    if is_truncated:
        problems.append(Problem(path, "last line truncated", "the line is left out"))
    if damaged:
        problems.append(Problem(path, f"{damaged} damaged rows", "the rows or cells are left out"))
    if not values:
        return {}
    table = np.array([values[step] for step in sorted(values)])
    return {name: table[:, i] for i, name in enumerate(columns)}


def read_evaluation(folder: Path) -> Evaluation:
    """Read one evaluation folder.

    Raises:
        UserError: there is no summary, or it lacks numbers that every report needs.
    """
    summary = migrate_evaluation(read_json(folder / "summary.json"))
    missing = [name for name in NEEDED_NUMBERS if not isinstance(summary.get(name), int | float)]
    if missing:
        raise UserError(
            f"{folder / 'summary.json'} lacks {', '.join(missing)}. Evaluate the run again."
        )
    return Evaluation(folder, summary)


def _number(cell: str | None) -> float | None:
    """Return a cell's number: NaN if it is empty, None if it is damaged."""
    try:
        return None if cell is None else float(cell or "nan")
    except ValueError:
        return None


def _run_folders(paths: Sequence[Path], problems: list[Problem]) -> list[Path]:
    found: dict[Path, Path] = {}
    for path in paths:
        inside = [path] if (path / "config.json").is_file() else []
        inside = inside or sorted(config.parent for config in path.rglob("config.json"))
        if not inside:
            what = "holds no run folder" if path.is_dir() else "does not exist"
            problems.append(Problem(path, what, "left out"))
        for folder in inside:
            found.setdefault(folder.resolve(), folder)  # a folder given twice counts once
    return list(found.values())
