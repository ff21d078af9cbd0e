"""Collection of a study: sorts runs and evaluations into tasks and agents."""

import json
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from knowarm.report.format import differing, flatten, slugs
from knowarm.report.read import read_folders
from knowarm.report.study import (
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

PREFERRED_LABEL = "post-training-greedy"
UNTRAINED, LATEST, HELD_OUT = "-untrained", "-latest", "-held-out"
"""Suffixes of evaluations other than that of the best model on its training task."""

COLOURS = {"fixed": "fixed colours", "randomized": "randomized colours"}

NOT_THE_TASK = {"renderer", "image_size", "name"}
"""Fields of ``env`` that do not make a different task."""

NOT_THE_CHOICE = {"marked"}
"""Fields of ``env.choice`` that do not make a different task: the upper bound solves the same."""

NOT_A_SETTING = {"agent", "role", "name", "seed", "env", "format", "checkpoint_every_steps"}
"""Top-level fields of the config that are no setting of the agent."""

NOT_A_RULE = ("record", "blind")
"""Beginnings of the names of evaluation settings that do not change the agent's numbers."""

DRAWS = {"knowledge.seed"}
"""Settings that only seed random draws: runs that differ in them are seeds of one agent."""


def collect(paths: Sequence[Path], references: Mapping[str, Path] | None = None) -> Study:
    """Read run folders and sort them into tasks and agents; arguments as `read_folders`."""
    return arrange(*read_folders(paths, references))


def arrange(runs: list[Run], references: Sequence[Reference], problems: Sequence[Problem]) -> Study:
    """Sort runs into tasks and agents; what does not fit becomes a further problem."""
    problems = list(problems)
    known = [*_untrained(runs), *references]
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


def rules(evaluation: Evaluation) -> str:
    """Return a text that is equal for evaluations on the same episodes with the same thresholds."""
    kept = {k: v for k, v in evaluation.config.items() if not k.startswith(NOT_A_RULE)}
    return json.dumps([evaluation.summary["episodes"], kept], sort_keys=True)


def _comparable(runs: list[Run], label: str, problems: list[Problem]) -> list[Run]:
    """Drop evaluations on other episodes or with other thresholds than most."""
    found = {run.path: rules(run.evaluations[label]) for run in runs if label in run.evaluations}
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
        rest = [COLOURS.get(colours, COLOURS["fixed"]), runs[0].algorithm]
        if choice := runs[0].env.get("choice"):
            rest.insert(0, f"choice of {choice.get('objects')}")
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
    if isinstance(choice := env.get("choice"), dict):
        env["choice"] = {name: v for name, v in choice.items() if name not in NOT_THE_CHOICE}
    return json.dumps([env, run.algorithm], sort_keys=True)


def _agent_settings(run: Run) -> dict[str, Any]:
    """Return everything but task and seed, flattened to dotted names."""
    kept = {name: value for name, value in run.config.items() if name not in NOT_A_SETTING}
    return {name: value for name, value in flatten(kept).items() if name not in DRAWS}
