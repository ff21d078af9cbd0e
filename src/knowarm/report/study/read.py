"""A run folder goes in; its run, or the reason why there is none, comes out."""

from json import JSONDecodeError
from pathlib import Path
from typing import Any

import numpy as np

from knowarm.errors import UserError
from knowarm.experiment.run_folder import RunFolder, read_csv, read_json
from knowarm.report.study.model import Curve, Judged, Problem, Run

NEEDED_NUMBERS = ("episodes", "return_mean", "success", "accuracy")
NEEDED_CONFIG = ("agent", "seed", "env", "algorithm")


def read_run(path: Path, problems: list[Problem]) -> Run | None:
    """Read one run folder; whatever is wrong is named in ``problems``.

    Returns:
        The run, or None when the folder is none, of another format or without its config.
    """
    try:
        _object(path / "config.json")
        folder = RunFolder.open(path)
        config = folder.config()
    except UserError as error:
        problems.append(Problem(path, str(error), "left out"))
        return None
    missing = [name for name in NEEDED_CONFIG if name not in config]
    if missing:
        problems.append(Problem(path, f"config.json lacks {', '.join(missing)}", "left out"))
        return None
    try:
        provenance = _object(path / "provenance.json")
    except UserError as error:
        problems.append(Problem(path, str(error), "kept; versions and parameters unknown"))
        provenance = {}
    run = Run(
        path=path,
        config=config,
        provenance=provenance,
        interim=read_curve(folder.evaluations_path, problems),
        metrics=read_curve(folder.metrics_path, problems),
        judged=_read_judged(path / "evaluation", problems),
    )
    if not run.interim:
        problems.append(
            Problem(path, "no interim evaluations", "kept; missing from the learning curves")
        )
    if not run.judged:
        problems.append(
            Problem(path, "no post-training evaluation", "kept; missing from the tables of results")
        )
    if run.total_steps and 0 < run.steps_done < 0.98 * run.total_steps:
        share = run.steps_done / run.total_steps
        problems.append(
            Problem(
                path,
                f"stopped after {share:.0%} of its steps",
                "kept; censored at its end, its last success carried on",
            )
        )
    return run


def read_curve(path: Path, problems: list[Problem]) -> Curve:
    """Columns of a CSV log as numbers; empty when the file is missing or holds no row.

    A last line without its end, rows without a step and cells that are no numbers come from a
    crash: the row, or the cell, is left out and named. Of two rows of the same step, as a resumed
    run may leave, the later one counts.
    """
    if not path.is_file():
        return {}
    try:
        text = path.read_bytes().decode()
        rows = read_csv(path)
    except (OSError, ValueError) as error:
        problems.append(Problem(path, f"cannot be read ({error})", "left out"))
        return {}
    cut = bool(text) and not text.endswith("\n")
    columns = [name for name in (rows[0] if rows else {}) if name]
    values: dict[float, list[float]] = {}
    broken = 0
    for row in rows:
        numbers = [_number(row.get(name)) for name in columns]
        step = dict(zip(columns, numbers, strict=True)).get("step")
        if step is None or np.isnan(step):
            broken += 1
            continue
        broken += any(number is None for number in numbers)
        values[step] = [np.nan if number is None else number for number in numbers]
    if cut:
        problems.append(Problem(path, "last line cut short", "the line is left out"))
    if broken:
        problems.append(Problem(path, f"{broken} damaged rows", "the rows or cells are left out"))
    if not values:
        return {}
    table = np.array([values[step] for step in sorted(values)])
    return {name: table[:, i] for i, name in enumerate(columns)}


def read_judged(folder: Path) -> Judged:
    """One evaluation folder.

    Raises:
        UserError: no summary, or one that lacks the numbers every report needs.
    """
    summary = _object(folder / "summary.json")
    missing = [name for name in NEEDED_NUMBERS if not isinstance(summary.get(name), int | float)]
    if missing:
        raise UserError(
            f"{folder / 'summary.json'} lacks {', '.join(missing)}. Evaluate the run again."
        )
    return Judged(folder, summary)


def _object(path: Path) -> dict[str, Any]:
    """Read a JSON file that must hold named values.

    Raises:
        UserError: the file is missing, not JSON, or holds something else.
    """
    values: object = read_json(path)
    if not isinstance(values, dict):
        raise UserError(f"{path} must hold named values, it holds a {type(values).__name__}.")
    return values


def _read_judged(parent: Path, problems: list[Problem]) -> dict[str, Judged]:
    judged = {}
    for folder in sorted(path for path in parent.glob("*") if path.is_dir()):
        try:
            judged[folder.name] = read_judged(folder)
        except (UserError, JSONDecodeError) as error:
            problems.append(Problem(folder, str(error), "the evaluation is left out"))
    return judged


def _number(cell: Any) -> float | None:
    """A cell's number, nan for an empty one, None for a damaged one."""
    if cell == "":
        return float("nan")
    try:
        return float(cell)
    except (TypeError, ValueError):
        return None
