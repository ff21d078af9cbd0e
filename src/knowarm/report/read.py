"""Run folder reader of reports: every value that a page needs is checked where it is read."""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from knowarm.config import to_dict
from knowarm.errors import UserError
from knowarm.experiment.algorithms import algorithm_of
from knowarm.experiment.config import StopWhen
from knowarm.experiment.csv_log import LARGEST, number_in, read_csv
from knowarm.experiment.run_folder import RunFolder, graph_content, with_graphs
from knowarm.knowledge.queries.queries import parse_query
from knowarm.questions import AND
from knowarm.reading import one_line, read_json
from knowarm.report.model import Curve, Evaluation, FolderProblem, RunData

CONFIG = {  # kinds of the values of ``config.json`` that a report uses, as `check` takes them
    "agent": str,
    "algorithm_name": str,
    "role": str,
    "seed": int,
    "total_steps": float,
    "stop_when": {"success": float, "evaluations": int},
    "env": {"robot": str, "colours": str, "task": {"kind": str, "objects": int}},
    "algorithm": {"name": str},
    "knowledge": {"detail": str, "scope": str, "source": {"kind": str}},
}
NEEDED_CONFIG = ("agent", "seed", "env", "algorithm")

PROVENANCE = {  # kinds of the values of ``provenance.json``
    "versions": {"*": str},
    "commit": str,
    "machine": {"processor": str},
    "parameter_counts": {"*": int},
    "facets": [[str]],
    "knowledge": {
        **{"config": {"detail": str}, "slots": [str], "facets": [[str]]},
        **{"coverage": {"share": float}, "dim": int, "norm": float},
        **{"sentences": {"*": str}, "note": str},
    },
}

NUMBERS = {
    f"{name}{end}": float
    for name in (
        *("return_mean", "return_std", "length_mean", "length_std", "success", "success_wide"),
        *("accuracy", "difference", "needs_eyes", "choice", "choice_chance", "chose_old_answer"),
        *("failure_distance_mean", "failure_distance_std", "failure_distance_max"),
        *("success_if_chosen", "right_object", "lifted", "grasps"),
    )
    for end in ("", "_low", "_high")
} | {"episodes": int, "lift_episodes": int, "lift_outcomes": {"*": int}}
NEEDED_NUMBERS = ("episodes", "return_mean", "success", "accuracy")

SUMMARY = NUMBERS | {  # kinds of the values of an evaluation's ``summary.json``
    "env": {},
    "joints": [str],
    "config": {
        **dict.fromkeys(("distance_m", "angle_deg", "wide_angle_deg"), float),
        **{"seeds": int, "actions": str, "split": str},
    },
    **{key: {"*": NUMBERS} for key in ("per_target", "per_facet", "per_query", "blind_agents")},
}


def read_folders(paths: Sequence[Path]) -> tuple[list[RunData], list[FolderProblem]]:
    """Read run folders, at any depth."""
    problems: list[FolderProblem] = []
    runs = []
    for path in _run_folders(paths, problems):
        with _attempt(path, "left out", problems):
            runs.append(read_run(path, problems))
    if not runs:
        reasons = "; ".join(f"{p.path}: {p.what}" for p in problems[:3]) or "no folder was given"
        give = "Give run folders such as runs/irb120-full-fast/0."
        raise UserError(f"Nothing to report: {reasons}. {give}")
    return runs, problems


def read_run(path: Path, problems: list[FolderProblem]) -> RunData:
    """Read one run folder; defects of files other than its config become ``problems``."""
    folder = RunFolder.open(path)
    config = check(folder.config(), CONFIG)
    if missing := [name for name in NEEDED_CONFIG if name not in config]:
        raise UserError(f"config.json lacks {', '.join(missing)}")
    with suppress(UserError):  # a field that the run's version did not have takes its default
        config = with_graphs(to_dict(folder.experiment()), graph_content)
    provenance: dict[str, Any] = {}
    with _attempt(path, "kept; versions and parameters unknown", problems):
        provenance = check(folder.provenance(), PROVENANCE)
    folder_curves = (folder.evaluations_path, folder.metrics_path)
    evaluations = {}
    for each in sorted(each for each in (path / "evaluation").glob("*") if each.is_dir()):
        with _attempt(each, "the evaluation is left out", problems):
            evaluations[each.name] = read_evaluation(each)
    interim, metrics = (read_curve(each, problems) for each in folder_curves)
    run = RunData(path, config, provenance, interim, metrics, evaluations, algorithm_of(config))
    for found, what, where in (
        (run.interim, "no interim evaluations", "learning curves"),
        (evaluations, "no post-training evaluation", "tables of results"),
    ):
        if not found:
            problems.append(FolderProblem(path, what, f"kept; missing from the {where}"))
    total = config.get("total_steps")
    if total and 0 < run.steps_done < 0.98 * total:
        what = f"stopped after {run.steps_done / total:.0%} of its steps"
        done = "kept; censored at its end"
        if (rule := config.get("stop_when")) and folder.ended_early_at(StopWhen(**rule)):
            success, count = rule["success"], rule["evaluations"]
            what += f", as its stop_when says (success {success:.0%} {count}x)"
            done += ", its last success extended"
            run = replace(run, ended_early=True)
        else:
            done += ", left out of means over longer trainings"
        problems.append(FolderProblem(path, what, done))
    return run


def read_curve(path: Path, problems: list[FolderProblem]) -> Curve:
    """Read the columns of a CSV log; empty if the file is missing or has no rows.

    Damaged rows and cells are left out and reported. Of two rows of a step the later one is kept.
    """
    if not path.is_file():
        return {}
    try:
        rows = read_csv(path)
        is_truncated = path.read_bytes()[-1:] not in (b"", b"\n")
    except (OSError, UserError) as error:
        problems.append(FolderProblem(path, f"cannot be read ({error})", "left out"))
        return {}
    columns = [name for name in dict.fromkeys(name for row in rows for name in row) if name]
    values: dict[float, list[float]] = {}
    damaged = 0
    for row in rows:
        numbers = {name: number_in(row, name) for name in columns}
        step = numbers["step"]
        if step is None or step < 0:
            damaged += 1
            continue
        damaged += any(
            n is None and row.get(name) not in ("", "nan") for name, n in numbers.items()
        )
        values[step] = [np.nan if number is None else number for number in numbers.values()]
    if is_truncated:
        problems.append(FolderProblem(path, "last line truncated", "the line is left out"))
    if damaged:
        what = f"{damaged} damaged rows"
        problems.append(FolderProblem(path, what, "the rows or cells are left out"))
    if not values:
        return {}
    table = np.array([values[step] for step in sorted(values)])
    known = np.isfinite(table).any(axis=0)  # a column without any number is as good as missing
    return {name: table[:, i] for i, name in enumerate(columns) if known[i]}


def read_evaluation(folder: Path) -> Evaluation:
    """Read one evaluation folder; for the choose task, also compute `choice_numbers`."""
    path = folder / "summary.json"
    summary = check(read_json(path), SUMMARY)
    if missing := [name for name in NEEDED_NUMBERS if name not in summary]:
        raise UserError(f"{path} lacks {', '.join(missing)}. Evaluate the run again.")
    if "choice_chance" in summary:
        summary |= choice_numbers(summary)
    return Evaluation(folder, summary)


def choice_numbers(summary: Mapping[str, Any]) -> dict[str, Any]:
    """Compute the numbers of an evaluation of the choose task that are corrected for chance.

    ``choice_corrected`` is 0 for a choice at random, 1 if every choice is right;
    ``success_corrected`` is 0 for an agent that reaches the objects it chooses equally often, but
    chooses at random; ``switched`` (split S5) is the share of the new answer among episodes that
    ended at the new or the old one; ``per_type`` has both by the relations of a query.
    """
    chance, choice = summary["choice_chance"], summary["choice"]
    values: dict[str, Any] = {
        f"choice_corrected{end}": (summary[f"choice{end}"] - chance) / (1 - chance)
        for end in ("", "_low", "_high")
        if f"choice{end}" in summary
    }
    guessed = chance * summary["success_if_chosen"]
    values["success_corrected"] = (summary["success"] - guessed) / (1 - chance)
    if "chose_old_answer" in summary:
        either = choice + summary["chose_old_answer"]
        values["switched"] = choice / either if either else None
    by_type: dict[str, list[Mapping[str, float]]] = defaultdict(list)
    for query, numbers in summary.get("per_query", {}).items():
        by_type[query_type(query)].append(numbers)
    values["per_type"] = {}
    for kind, numbers in sorted(by_type.items()):
        weights = [each["episodes"] for each in numbers]
        values["per_type"][kind] = {"episodes": sum(weights)} | {
            key: float(np.average([each[key] for each in numbers], weights=weights))
            for key in ("choice", "success")
        }
    return values


def query_type(text: str) -> str:
    """Return the relations of a query: "usedFor and hasColor"; other texts as they are."""
    try:
        return AND.join(condition.relation for condition in parse_query(text).conditions)
    except UserError:
        return text


def check(value: Any, kind: Any, where: str = "") -> Any:
    """Return a JSON value without its unknown (null) fields; ValueError if it is of another kind.

    A kind is a type; a list with the kind of all elements; or a mapping with the kinds of fields,
    in which "*" stands for all others and fields without a kind may hold anything. ``float``
    takes integers; numbers must be finite. ``where`` names the value in the message.
    """
    if isinstance(kind, dict) and isinstance(value, dict):
        kinds = {name: kind.get(name, kind.get("*")) for name in value}
        return {
            name: each if kinds[name] is None else check(each, kinds[name], f"{where}.{name}")
            for name, each in value.items()
            if each is not None or kinds[name] is None
        }
    if isinstance(kind, list) and isinstance(value, list):
        return [check(each, kind[0], where) for each in value]
    if kind in (int, float) and not isinstance(value, bool):
        numbers = int if kind is int else int | float
        if isinstance(value, numbers) and abs(value) <= LARGEST:
            return value
    elif isinstance(kind, type) and isinstance(value, kind):
        return value
    raise ValueError(f"{where.lstrip('.') or 'the file'} is {str(value)[:40]!r}")


@contextmanager
def _attempt(path: Path, done: str, problems: list[FolderProblem]) -> Iterator[None]:
    """Report whatever damaged content of a file or folder raises as one of the problems."""
    try:
        yield
    except Exception as error:
        what = str(error) if isinstance(error, UserError) else f"damaged: {one_line(error)}"
        problems.append(FolderProblem(path, what, done))


def _run_folders(paths: Sequence[Path], problems: list[FolderProblem]) -> list[Path]:
    found: dict[Path, Path] = {}
    for path in paths:
        inside = [path] if (path / "config.json").is_file() else []
        inside = inside or sorted(config.parent for config in path.rglob("config.json"))
        if not inside:
            what = "holds no run folder" if path.exists() else "does not exist"
            if path.is_file():
                what = "is no folder; unpack a packed study first: knowarm study unpack"
            problems.append(FolderProblem(path, what, "left out"))
        for folder in inside:
            found.setdefault(folder.resolve(), folder)  # a folder given twice counts once
    return list(found.values())
