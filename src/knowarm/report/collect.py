"""Collection of a study: reads run folders, and sorts their runs into tasks and agents."""

import json
from collections import Counter, defaultdict
from collections.abc import (
    Callable,
    Collection,
    Iterable,
    Iterator,
    Mapping,
    Sequence,
)
from contextlib import contextmanager
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from knowarm.config import flatten, to_dict
from knowarm.errors import UserError, shell_command
from knowarm.experiment.agents import AGENTS
from knowarm.experiment.csv_log import number_in, read_csv
from knowarm.experiment.provenance import Provenance
from knowarm.experiment.run_folder import RunFolder
from knowarm.experiment.run_inputs import input_content, with_inputs
from knowarm.experiment.summary import Summary
from knowarm.reading import one_line, read_bytes
from knowarm.report.format import differing, palette, slugs
from knowarm.report.model import (
    HELD_OUT,
    LATEST,
    UNTRAINED,
    Curve,
    Evaluation,
    FolderProblem,
    Group,
    Problems,
    Reference,
    RunData,
    Runs,
    StudyData,
    TaskData,
    evaluated_runs,
    rank,
)
from knowarm.world.robots import ROBOTS

GIVE = "Give run folders such as runs/irb120-full-fast/0."
Fields = dict[str, Any]
"""Fields of a config by their dotted names."""

PREFERRED_LABEL = "post-training-greedy"
# Fields of ``env`` that do not make a different task: of the image, and those that an agent sets.
NOT_THE_TASK = {"renderer", "image_size"}
for _agent in AGENTS.values():
    NOT_THE_TASK |= {f"task.asked.{field}" for field in _agent.asked}
# Top-level fields of the config that are no setting of the agent.
NOT_A_SETTING = {"agent", "role", "name", "seed", "env", "checkpoint_every_steps"}
# Settings that only seed random draws: runs that differ in them are seeds of one agent.
DRAWS = {"knows.seed"}
MOST_REFERENCES = 2  # untrained policies of a task, enough to compare with
OTHER_RULES = (
    "evaluated on other episodes or with other thresholds than most runs of its task"
)


def collect(paths: Sequence[Path]) -> StudyData:
    """Read run folders, at any depth, and sort them into tasks and agents."""
    runs, problems = read_folders(paths)
    everyone = sorted(runs, key=_reference_order)
    by_task = list(_grouped(runs, _task_key).values())
    titles = _titles(by_task)
    names = slugs(ids for ids, _ in titles)
    tasks = []
    for (ids, title), task_runs in zip(titles, by_task, strict=True):
        tasks.append(_task(names[ids], title, task_runs, everyone, problems))
    _report_versions(runs, problems)
    tasks.sort(key=lambda task: task.title)
    problems.sort(key=lambda problem: str(problem.path))
    return StudyData(tuple(tasks), tuple(problems))


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


def _grouped(runs: Iterable[RunData], key: Callable[[RunData], str]) -> dict[str, Runs]:
    """Return the runs of each key, in the order of the first of each."""
    groups: dict[str, Runs] = defaultdict(list)
    for run in runs:
        groups[key(run)].append(run)
    return groups


def _task(
    name: str,
    title: str,
    runs: Runs,
    everyone: Runs,
    problems: Problems,
) -> TaskData:
    label = _label(runs)
    runs = _comparable(runs, label, problems)
    by_name: dict[str, Runs] = {}
    for same_agent in _grouped(runs, lambda run: run.config.agent).values():
        for group_name, same_settings in _by_settings(same_agent).items():
            by_name[group_name] = _one_run_per_seed(same_settings, problems)
    by_rank = sorted(by_name.items(), key=lambda item: rank(item[1][0].config))
    colours = palette((name, runs[0].config.agent) for name, runs in by_rank)
    groups = [Group.of(name, colours[name], runs, label) for name, runs in by_rank]
    references: list[Reference] = []
    for run in evaluated_runs(runs, label)[:1]:
        references = _references(everyone, run.evaluations[label])
    return TaskData(
        name=name,
        title=title,
        label=label,
        groups=tuple(groups),
        references=tuple(references),
    )


def _by_settings(runs: Runs) -> dict[str, Runs]:
    """Return runs of one agent by a name that has the settings in which they differ."""
    names = differing(list(map(_agent_settings, runs)))

    def group_name(run: RunData) -> str:
        settings = _agent_settings(run)
        details = [f"{name.split('.')[-1]}={settings.get(name)}" for name in names]
        return " · ".join([run.config.agent, *details])

    return _grouped(runs, group_name)


def _references(runs: Runs, compared: Evaluation) -> list[Reference]:
    """Return untrained policies on the task and by the rules of an evaluation, one per agent."""
    env = _task_env(compared.summary.env)
    references: dict[str, Reference] = {}
    for run in runs:
        name = f"untrained {run.config.agent}"
        for label, evaluation in run.evaluations.items():
            is_alike = (
                label.endswith(UNTRAINED)
                and evaluation.rules == compared.rules
                and _task_env(evaluation.summary.env) == env
            )
            if is_alike:
                references.setdefault(name, Reference(name, "c-faint", [evaluation]))
    return list(references.values())[:MOST_REFERENCES]


def _reference_order(run: RunData) -> tuple[Any, ...]:
    """Return the sort key of untrained policies: of one role, the most detail first."""
    role, *agent = rank(run.config)
    return role, -run.config.knows.rank, agent, run.config.seed


def _label(runs: Runs) -> str:
    """Return the most common evaluation of the best model; of equally common ones the greedy."""
    counts: Counter[str] = Counter()
    for run in runs:
        for label, evaluation in run.evaluations.items():
            counts[label] += not evaluation.is_solved
    counts = +counts
    others = (UNTRAINED, LATEST, HELD_OUT)
    best = [label for label in sorted(counts) if not label.endswith(others)]
    return max(
        best, key=lambda label: (counts[label], label == PREFERRED_LABEL), default=""
    )


def _comparable(runs: Runs, label: str, problems: Problems) -> Runs:
    """Drop evaluations on other episodes or with other thresholds than most."""
    compared = [run.evaluations[label] for run in evaluated_runs(runs, label)]
    usual = _most_common(evaluation.rules for evaluation in compared)
    kept = []
    for run in runs:
        evaluation = run.evaluations.get(label)
        if evaluation and evaluation.rules != usual:
            done = "the evaluation is left out"
            problems.append(FolderProblem(evaluation.folder, OTHER_RULES, done))
            run = replace(run, evaluations=_without(run.evaluations, [label]))
        kept.append(run)
    return kept


def _one_run_per_seed(runs: Runs, problems: Problems) -> Runs:
    """Keep, of several runs of one seed, the one with the most steps, then the last by path."""
    chosen: dict[int, RunData] = {}
    for run in sorted(runs, key=lambda run: (run.steps_done, str(run.path))):
        seed = run.config.seed
        if seed in chosen:
            what = f"same agent, task and seed {seed} as {run.path}, which has no fewer steps"
            problems.append(FolderProblem(chosen[seed].path, what, "left out"))
        chosen[seed] = run
    return [chosen[seed] for seed in sorted(chosen)]


def _titles(tasks: list[Runs]) -> list[tuple[str, str]]:
    """Return two titles per task, with names and for people; fields tell equal ones apart."""
    firsts = [(_title(runs[0]), flatten(runs[0].settings["env"])) for runs in tasks]
    titles = []
    for title, env in firsts:
        same_title = [fields for other, fields in firsts if other == title]
        robot, robot_title, *parts = title
        parts += [f"{name} {env.get(name)}" for name in differing(same_title)]
        titles.append((" · ".join([robot, *parts]), " · ".join([robot_title, *parts])))
    return titles


def _title(run: RunData) -> tuple[str, ...]:
    """Return what the titles of a run's task consist of: the robot, its title, and the rest."""
    env = run.config.env
    name = Path(env.robot).stem  # of a description of one's own
    title = (
        name,
        ROBOTS[name].title if env.robot in ROBOTS else name,
        env.task.title,
        f"{env.colours} colours",
        run.config.learner,
    )
    return tuple(filter(None, title))


def _report_versions(runs: Runs, problems: Problems) -> None:
    """Report the runs that were made with another version of the package than most."""
    versions = {run.path: run.provenance.versions.get("knowarm") for run in runs}
    usual = _most_common(filter(None, versions.values()))
    done = "merged: the run format is the same"
    for path, version in versions.items():
        if version and version != usual:
            what = f"made with knowarm {version}, most runs with {usual}"
            problems.append(FolderProblem(path, what, done))


def _most_common(values: Iterable[str]) -> str | None:
    """Return the most common value; of equally common ones the first by name."""
    for value, _ in Counter(sorted(values)).most_common(1):
        return value
    return None


def _task_key(run: RunData) -> str:
    """Return a key that is equal for runs on the same task with the same algorithm."""
    env = _task_env(run.settings["env"])
    return json.dumps([env, run.config.learner], sort_keys=True)


def _task_env(env: Mapping[str, Any]) -> Fields:
    """Return the fields that make the task of an environment."""
    return _without(flatten(env), NOT_THE_TASK)


def _agent_settings(run: RunData) -> Fields:
    """Return all fields but those of task and seed."""
    settings = flatten(_without(run.settings, NOT_A_SETTING))
    env = flatten(run.settings["env"])
    for name in NOT_THE_TASK:
        settings[f"env.{name}"] = env.get(name)
    return _without(settings, DRAWS)


def _without(values: Mapping[str, Any], names: Collection[str]) -> dict[str, Any]:
    return {name: value for name, value in values.items() if name not in names}
