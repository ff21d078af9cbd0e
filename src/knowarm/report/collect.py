"""Run folder reader: reads runs and their evaluations and sorts them into tasks and agents."""

import json
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from knowarm.errors import UserError
from knowarm.experiment.config import StopWhen
from knowarm.experiment.migration import migrate_evaluation
from knowarm.experiment.run_folder import RunFolder, read_csv, read_json
from knowarm.report.format import differing, flatten, slugs
from knowarm.report.study import (
    Curve,
    Evaluation,
    Group,
    Problem,
    Reference,
    Run,
    Study,
    Task,
    rank,
)
from knowarm.world.robots import ROBOTS

NEEDED_NUMBERS = ("episodes", "return_mean", "success", "accuracy")
NEEDED_CONFIG = {"agent": str, "seed": int, "env": dict, "algorithm": dict}

PREFERRED_LABEL = "post-training-greedy"
UNTRAINED, LATEST, HELD_OUT = "-untrained", "-latest", "-held-out"
"""Suffixes of evaluations other than that of the best model on its training task."""

COLOURS = {"fixed": "fixed colours", "randomized": "randomized colours"}

NOT_THE_TASK = {"renderer", "image_size", "name"}
"""Fields of ``env`` that do not make a different task."""

NOT_A_SETTING = {"agent", "role", "name", "seed", "env", "format", "checkpoint_every_steps"}
"""Top-level fields of the config that are no setting of the agent."""

NOT_A_RULE = ("record", "blind")
"""Beginnings of the names of evaluation settings that do not change the agent's numbers."""

DRAWS = {"knowledge.seed"}
"""Settings that only seed random draws: runs that differ in them are seeds of one agent."""


def collect(paths: Sequence[Path], references: Mapping[str, Path] | None = None) -> Study:
    """Read run folders and sort them into tasks and agents.

    Args:
        paths: run folders, or folders that hold them at any depth.
        references: evaluation folders of policies that have no run, by name.

    Raises:
        UserError: the paths hold nothing that can be reported.
    """
    problems: list[Problem] = []
    runs = [run for path in _run_folders(paths, problems) if (run := read_run(path, problems))]
    if not runs:
        reasons = "; ".join(f"{p.path}: {p.what}" for p in problems[:3]) or "no folder was given"
        raise UserError(
            f"Nothing to report: {reasons}. Give run folders such as runs/irb120-full-ppo/0."
        )
    known = _untrained(runs)
    for name, path in (references or {}).items():
        try:
            known.append(Reference(name, (read_evaluation(path),)))
        except UserError as error:
            problems.append(Problem(path, str(error), "left out"))
    by_task: dict[str, list[Run]] = defaultdict(list)
    for run in runs:
        by_task[_task_key(run)].append(run)
    titles = _titles(list(by_task.values()))
    names = slugs(ids for ids, _ in titles)
    tasks = [
        _task(names[ids], title, members, known, problems)
        for (ids, title), members in zip(titles, by_task.values(), strict=True)
    ]
    _report_versions(runs, problems)
    return Study(
        tuple(sorted(tasks, key=lambda task: task.title)),
        tuple(sorted(problems, key=lambda problem: str(problem.path))),
    )


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

    A truncated last line, rows without a step and cells that are not numbers stem from a crash:
    the row, or the cell, is left out and reported. Of two rows of the same step, as a resumed run
    may leave, the later one is kept.
    """
    if not path.is_file():
        return {}
    try:
        text = path.read_bytes().decode()
        rows = read_csv(path)
    except (OSError, ValueError) as error:
        problems.append(Problem(path, f"cannot be read ({error})", "left out"))
        return {}
    columns = [name for name in (rows[0] if rows else {}) if name]
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
    if text and not text.endswith("\n"):
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


def _number(cell: Any) -> float | None:
    """Return a cell's number: NaN if it is empty, None if it is damaged."""
    try:
        return float("nan") if cell == "" else float(cell)
    except (TypeError, ValueError):
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


def _task(
    name: str, title: str, runs: list[Run], known: list[Reference], problems: list[Problem]
) -> Task:
    label = _label(runs)
    runs = _comparable(runs, label, problems)
    by_agent: dict[str, list[Run]] = defaultdict(list)
    for run in runs:
        by_agent[run.agent].append(run)
    groups: list[Group] = []
    for agent, same_agent in by_agent.items():
        settings = [_agent_settings(run) for run in same_agent]
        fields = differing(settings)
        members: dict[str, list[Run]] = defaultdict(list)
        for run, values in zip(same_agent, settings, strict=True):
            details = [f"{field.split('.')[-1]}={values.get(field)}" for field in fields]
            members[" · ".join([agent, *details])].append(run)
        role = same_agent[0].role
        groups += [
            Group(each, agent, role, _one_run_per_seed(chosen, problems), label)
            for each, chosen in members.items()
        ]
    evaluation = next((run.evaluations[label] for run in runs if label in run.evaluations), None)
    fitting = [
        each for each in known if evaluation and _same_rules(each.evaluations[0], evaluation)
    ]
    untrained = [each for each in fitting if each.untrained][:2]  # enough to compare with
    others = [each for each in fitting if not each.untrained]
    groups.sort(key=lambda group: rank(group.role, group.agent))
    return Task(name, title, label, tuple(groups), (*untrained, *others))


def _untrained(runs: list[Run]) -> list[Reference]:
    """Return the untrained policy's evaluation of each agent, from its lowest seed that has one."""
    found: dict[tuple[str, str], Reference] = {}

    def order(run: Run) -> tuple[Any, ...]:  # of one role, the most detail first
        ranked = rank(run.role, run.agent)
        return ranked[0], -run.detail, ranked, run.seed

    for run in sorted(runs, key=order):
        for label, evaluation in run.evaluations.items():
            if label.endswith(UNTRAINED):
                reference = Reference(f"untrained {run.agent}", (evaluation,), untrained=True)
                found.setdefault((_task_key(run), run.agent), reference)
    return list(found.values())


def _label(runs: list[Run]) -> str:
    """Return the most common evaluation of the best model; of equally common ones the greedy."""
    labels = (label for run in runs for label in run.evaluations)
    counts = Counter(label for label in labels if not label.endswith((UNTRAINED, LATEST, HELD_OUT)))
    return max(sorted(counts), key=lambda n: (counts[n], n == PREFERRED_LABEL), default="")


def _same_rules(first: Evaluation, second: Evaluation) -> bool:
    """Return whether two policies were evaluated on the same episodes with the same thresholds."""
    env = ("robot", "targets", "colours")
    config = ("episodes", "seed", "seeds", "distance_m", "angle_deg")
    rules = [
        [each.summary.get("env", {}).get(name) for name in env]
        + [each.config.get(name) for name in config]
        for each in (first, second)
    ]
    return rules[0] == rules[1]


def _comparable(runs: list[Run], label: str, problems: list[Problem]) -> list[Run]:
    """Drop evaluations on other episodes or with other thresholds than most."""

    def settings(evaluation: Evaluation) -> str:
        kept = {k: v for k, v in evaluation.config.items() if not k.startswith(NOT_A_RULE)}
        return json.dumps([evaluation.summary["episodes"], kept], sort_keys=True)

    found = {run.path: settings(run.evaluations[label]) for run in runs if label in run.evaluations}
    usual = _most_common(found.values())
    kept = []
    for run in runs:
        if label and found.get(run.path, usual) != usual:
            what = "evaluated on other episodes or with other thresholds than most runs of its task"
            folder = run.evaluations[label].folder
            problems.append(Problem(folder, what, "the evaluation is left out"))
            others = {name: each for name, each in run.evaluations.items() if name != label}
            run = replace(run, evaluations=others)
        kept.append(run)
    return kept


def _one_run_per_seed(runs: list[Run], problems: list[Problem]) -> tuple[Run, ...]:
    """Keep, of several runs of one seed, the one with the most steps, then the last by path."""
    chosen: dict[int, Run] = {}
    for run in sorted(runs, key=lambda run: (run.steps_done, str(run.path))):
        if (other := chosen.get(run.seed)) is not None:
            what = f"same agent, task and seed {run.seed} as {run.path}, which has more steps"
            problems.append(Problem(other.path, what, "left out"))
        chosen[run.seed] = run
    return tuple(chosen[seed] for seed in sorted(chosen))


def _titles(tasks: list[list[Run]]) -> list[tuple[str, str]]:
    """Return two titles per task, with names and for people; fields tell equal ones apart."""
    short = []
    for runs in tasks:
        robot, colours = (str(runs[0].env.get(name)) for name in ("robot", "colours"))
        title = ROBOTS[robot].title if robot in ROBOTS else robot
        rest = [COLOURS.get(colours, COLOURS["fixed"]), runs[0].algorithm.upper()]
        short.append((" · ".join([robot, *rest]), " · ".join([title, *rest])))
    titles = []
    for both, runs in zip(short, tasks, strict=True):
        alike = [flatten(r[0].env) for other, r in zip(short, tasks, strict=True) if other == both]
        env = flatten(runs[0].env)
        details = [f"{name} {env.get(name)}" for name in differing(alike)]
        titles.append((" · ".join([both[0], *details]), " · ".join([both[1], *details])))
    return titles


def _report_versions(runs: list[Run], problems: list[Problem]) -> None:
    """Report the runs that were made with another version of the package than most."""
    versions = {run.path: run.provenance.get("versions", {}).get("knowarm") for run in runs}
    usual = _most_common(filter(None, versions.values()))
    for path, version in versions.items():
        if version and version != usual:
            what = f"made with knowarm {version}, most runs with {usual}"
            problems.append(Problem(path, what, "merged: the run format is the same"))


def _most_common(values: Any) -> Any:
    counts = Counter(values)
    return max(sorted(counts), key=lambda value: counts[value], default=None)


def _task_key(run: Run) -> str:
    """Return a key that is equal for runs on the same task with the same algorithm."""
    env = {name: value for name, value in run.env.items() if name not in NOT_THE_TASK}
    return json.dumps([env, run.algorithm], sort_keys=True)


def _agent_settings(run: Run) -> dict[str, Any]:
    """Return everything but task and seed, flattened to dotted names."""
    kept = {name: value for name, value in run.config.items() if name not in NOT_A_SETTING}
    return {name: value for name, value in flatten(kept).items() if name not in DRAWS}
