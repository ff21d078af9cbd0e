"""Paths go in; the study they hold, with everything that was wrong named, comes out."""

import json
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path

from knowarm.errors import UserError
from knowarm.report.slug import slugs
from knowarm.report.study.model import (
    Group,
    Judged,
    Problem,
    Reference,
    Run,
    Study,
    Task,
)
from knowarm.report.study.read import read_judged, read_run
from knowarm.report.study.settings import (
    agent_settings,
    algorithm,
    differing,
    flatten,
    task_key,
)

PREFERRED_LABEL = "post-training-greedy"
UNTRAINED, LATEST, HELD_OUT = "-untrained", "-latest", "-held-out"
"""Ends of the labels of evaluations that are not of the best model on the task it learned."""

UNTRAINED_FIRST = {"bm": 0, "full": 1}
"""Whose untrained policies are shown: their networks differ in size."""

AGENT_ORDER = ("bm", "partial", "full", "full+", "target")
ROBOTS = {"irb120": "IRB120", "tiago": "TIAGo"}
COLOURS = {"fixed": "fixed colours", "randomized": "randomized colours"}


def collect(paths: Sequence[Path], references: Mapping[str, Path] | None = None) -> Study:
    """Read run folders and sort them into tasks and agents.

    Args:
        paths: run folders, or folders that hold them at any depth.
        references: evaluation folders of policies that have no run, by name.

    Raises:
        UserError: there is nothing in the paths that could be reported.
    """
    problems: list[Problem] = []
    runs = [read_run(path, problems) for path in _run_folders(paths, problems)]
    readable = [run for run in runs if run is not None]
    if not readable:
        reasons = "; ".join(f"{p.path}: {p.what}" for p in problems[:3]) or "no folder was given"
        raise UserError(
            f"Nothing to report: {reasons}. Give run folders such as runs/irb120-full-ppo/0."
        )
    known = [_reference(name, path, problems) for name, path in (references or {}).items()]
    known += untrained(readable)
    by_task: dict[str, list[Run]] = defaultdict(list)
    for run in readable:
        by_task[task_key(run)].append(run)
    titles = _titles(list(by_task.values()))
    names = slugs(titles)
    tasks = [
        _task(title, names[title], runs, [each for each in known if each], problems)
        for title, runs in zip(titles, by_task.values(), strict=True)
    ]
    _name_versions(readable, problems)
    return Study(
        tuple(sorted(tasks, key=lambda task: task.title)),
        tuple(sorted(problems, key=lambda problem: str(problem.path))),
    )


def _run_folders(paths: Sequence[Path], problems: list[Problem]) -> list[Path]:
    found: dict[Path, Path] = {}
    for path in paths:
        inside = [path] if (path / "config.json").is_file() else []
        inside = inside or sorted(config.parent for config in path.rglob("config.json"))
        if not inside:
            what = "holds no run folder" if path.is_dir() else "does not exist"
            problems.append(Problem(path, what, "left out"))
        for folder in inside:
            found.setdefault(folder.resolve(), folder)  # the same folder given twice counts once
    return list(found.values())


def _task(
    title: str, name: str, runs: list[Run], references: list[Reference], problems: list[Problem]
) -> Task:
    label = _label(runs)
    runs = _comparable(runs, label, problems)
    names: dict[str, list[Run]] = defaultdict(list)
    by_agent: dict[str, list[Run]] = defaultdict(list)
    for run in runs:
        by_agent[run.agent].append(run)
    for agent in sorted(by_agent, key=_agent_rank):
        settings = [agent_settings(run) for run in by_agent[agent]]
        fields = differing(settings)
        for run, values in zip(by_agent[agent], settings, strict=True):
            details = [f"{field.split('.')[-1]}={values.get(field)}" for field in fields]
            names[" · ".join([agent, *details])].append(run)
    groups = tuple(
        Group(name, members[0].agent, _one_run_a_seed(members, problems), label)
        for name, members in names.items()
    )
    first = runs[0]
    judged = next((run.judged[label] for run in runs if label in run.judged), None)
    return Task(
        name=name,
        title=title,
        robot=str(first.config["env"].get("robot", first.config.get("robot", "robot"))),
        colours=str(first.config["env"].get("colours", "fixed")),
        algorithm=algorithm(first),
        label=label,
        groups=groups,
        references=_references(references, judged),
    )


def _references(known: list[Reference], judged: Judged | None) -> tuple[Reference, ...]:
    """Those that played the task's episodes; of untrained policies two are enough to compare."""
    fitting = [each for each in known if judged and _same_episodes(each.judged, judged)]
    raw = [each for each in fitting if each.name.startswith("untrained ")]
    return (*raw[:2], *(each for each in fitting if each not in raw))


def untrained(runs: list[Run]) -> list[Reference]:
    """The evaluation of one untrained policy of each agent, from its lowest seed that has one.

    The baseline's and full's come first.
    """
    found: dict[tuple[str, str], Reference] = {}
    for run in sorted(runs, key=lambda run: (UNTRAINED_FIRST.get(run.agent, 2), run.seed)):
        for label, judged in run.judged.items():
            if label.endswith(UNTRAINED):
                key = (task_key(run), run.agent)
                found.setdefault(key, Reference(f"untrained {run.agent}", judged))
    return list(found.values())


def _label(runs: list[Run]) -> str | None:
    """The evaluation of the best model that most runs have; the greedy one among equals."""
    labels = (label for run in runs for label in run.judged)
    counts = Counter(label for label in labels if not label.endswith((UNTRAINED, LATEST, HELD_OUT)))
    if not counts:
        return None
    return max(sorted(counts), key=lambda name: (counts[name], name == PREFERRED_LABEL))


def _settings(judged: Judged) -> str:
    kept = {k: v for k, v in judged.summary.get("config", {}).items() if not k.startswith("record")}
    return json.dumps([judged.summary["episodes"], kept], sort_keys=True)


def _same_episodes(first: Judged, second: Judged) -> bool:
    """Whether the two played the same episodes by the same rule."""
    names = ("robot", "targets", "colours")
    tasks = [[each.summary.get("env", {}).get(name) for name in names] for each in (first, second)]
    rules = [flatten(each.summary.get("config", {})) for each in (first, second)]
    fields = ("episodes", "seed", "seeds", "distance_m", "angle_deg")
    return tasks[0] == tasks[1] and all(rules[0].get(f) == rules[1].get(f) for f in fields)


def _comparable(runs: list[Run], label: str | None, problems: list[Problem]) -> list[Run]:
    """Drop evaluations made by other rules than most: other episodes or thresholds."""
    counts = Counter(_settings(run.judged[label]) for run in runs if label in run.judged)
    if len(counts) < 2 or label is None:
        return runs
    usual = max(sorted(counts), key=lambda each: counts[each])
    kept = []
    for run in runs:
        if label in run.judged and _settings(run.judged[label]) != usual:
            what = "evaluated on other episodes or by other thresholds than most runs of its task"
            problems.append(Problem(run.judged[label].folder, what, "the evaluation is left out"))
            judged = {name: each for name, each in run.judged.items() if name != label}
            run = Run(run.path, run.config, run.provenance, run.interim, run.metrics, judged)
        kept.append(run)
    return kept


def _one_run_a_seed(runs: list[Run], problems: list[Problem]) -> tuple[Run, ...]:
    """Of two runs of the same seed the one that went further counts, then the last by path."""
    chosen: dict[int, Run] = {}
    for run in sorted(runs, key=lambda run: (run.steps_done, str(run.path))):
        if (other := chosen.get(run.seed)) is not None:
            what = f"same agent, task and seed {run.seed} as {run.path}, which went further"
            problems.append(Problem(other.path, what, "left out"))
        chosen[run.seed] = run
    return tuple(chosen[seed] for seed in sorted(chosen))


def _reference(name: str, path: Path, problems: list[Problem]) -> Reference | None:
    try:
        return Reference(name, read_judged(path))
    except UserError as error:
        problems.append(Problem(path, str(error), "left out"))
        return None


def _titles(tasks: list[list[Run]]) -> list[str]:
    """Robot, colours, algorithm, and where these are equal, the fields that differ."""
    short = []
    for runs in tasks:
        env = runs[0].config["env"]
        robot = str(env.get("robot", runs[0].config.get("robot", "robot")))
        colours = str(env.get("colours", "fixed"))
        parts = [ROBOTS.get(robot, robot), COLOURS.get(colours, colours)]
        short.append(" · ".join([*parts, algorithm(runs[0]).upper()]))
    titles = []
    for title, runs in zip(short, tasks, strict=True):
        alike = [r[0].config["env"] for t, r in zip(short, tasks, strict=True) if t == title]
        env = flatten(runs[0].config["env"])
        details = [f"{name} {env.get(name)}" for name in differing([flatten(a) for a in alike])]
        titles.append(" · ".join([title, *details]))
    return titles


def _agent_rank(agent: str) -> tuple[int, str]:
    return (AGENT_ORDER.index(agent) if agent in AGENT_ORDER else len(AGENT_ORDER), agent)


def _name_versions(runs: list[Run], problems: list[Problem]) -> None:
    """Runs of other versions of the package are merged, and said to be."""
    versions = {run.path: run.provenance.get("versions", {}).get("knowarm") for run in runs}
    counts = Counter(version for version in versions.values() if version)
    if len(counts) < 2:
        return
    usual = max(sorted(counts), key=lambda version: counts[version])
    for path, version in versions.items():
        if version and version != usual:
            what = f"made with knowarm {version}, most runs with {usual}"
            problems.append(Problem(path, what, "merged: the run format is the same"))
