"""Collection of a study: sorts runs and evaluations into tasks and agents."""

import json
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from knowarm.config import flatten, to_dict
from knowarm.experiment.agents import AGENTS
from knowarm.knowledge.queries.splits import SPLITS
from knowarm.report.format import differing, slugs
from knowarm.report.model import (
    Evaluation,
    FolderProblem,
    Group,
    Reference,
    RunData,
    SplitGroup,
    StudyData,
    TaskData,
    rank,
)
from knowarm.report.read import read_folders
from knowarm.world.robots import ROBOTS

PREFERRED_LABEL = "post-training-greedy"
# Suffixes of evaluations other than that of the best model on its training task.
UNTRAINED = "-untrained"
LATEST = "-latest"
HELD_OUT = "-held-out"
# Fields of ``env`` that do not make a different task, and those of ``env.task.asked`` that an
# agent sets.
NOT_THE_TASK = {"renderer", "image_size"}
NOT_A_TASK = {field for agent in AGENTS.values() for field in agent.asked}
# Top-level fields of the config that are no setting of the agent.
NOT_A_SETTING = {"agent", "role", "name", "seed", "env", "checkpoint_every_steps"}
# Evaluation settings that do not change the agent's numbers.
NOT_A_RULE = ("probes", "label")
# Settings that only seed random draws: runs that differ in them are seeds of one agent.
DRAWS = {"knows.seed"}
MOST_REFERENCES = 2  # untrained policies of a task, enough to compare with
OTHER_RULES = (
    "evaluated on other episodes or with other thresholds than most runs of its task"
)


def collect(paths: Sequence[Path]) -> StudyData:
    """Read run folders, at any depth, and sort them into tasks and agents."""
    runs, problems = read_folders(paths)
    references = _untrained(runs)
    by_task = list(_grouped(runs, _task_key).values())
    titles = _titles(by_task)
    names = slugs(ids for ids, _ in titles)
    tasks = []
    for (ids, title), task_runs in zip(titles, by_task, strict=True):
        tasks.append(_task(names[ids], title, task_runs, references, problems))
    _report_versions(runs, problems)
    tasks.sort(key=lambda task: task.title)
    problems.sort(key=lambda problem: str(problem.path))
    return StudyData(tuple(tasks), tuple(problems))


def _grouped(
    runs: Iterable[RunData], key: Callable[[RunData], str]
) -> dict[str, list[RunData]]:
    """Return the runs of each key, in the order of the first of each."""
    groups: dict[str, list[RunData]] = defaultdict(list)
    for run in runs:
        groups[key(run)].append(run)
    return groups


def _task(
    name: str,
    title: str,
    runs: list[RunData],
    references: list[Reference],
    problems: list[FolderProblem],
) -> TaskData:
    label = _label(runs)
    runs = _comparable(runs, label, problems)
    groups = []
    for same_agent in _grouped(runs, lambda run: run.config.agent).values():
        for group_name, same_settings in _by_settings(same_agent).items():
            chosen = _one_run_per_seed(same_settings, problems)
            groups.append(Group.of(group_name, chosen, label))
    groups.sort(key=lambda group: rank(group.role, group.agent))
    compared = [run.evaluations[label] for run in runs if label in run.evaluations]
    if not compared:
        return TaskData(name, title, label, tuple(groups))
    played = _played(compared[0])
    alike = [
        reference
        for reference in references
        if _played(reference.evaluations[0]) == played
    ]
    return TaskData(name, title, label, tuple(groups), tuple(alike[:MOST_REFERENCES]))


def _by_settings(runs: list[RunData]) -> dict[str, list[RunData]]:
    """Return runs of one agent by a name that has the settings in which they differ."""
    fields = differing([_agent_settings(run) for run in runs])

    def name(run: RunData) -> str:
        settings = _agent_settings(run)
        details = [f"{field.split('.')[-1]}={settings.get(field)}" for field in fields]
        return " · ".join([run.config.agent, *details])

    return _grouped(runs, name)


def _untrained(runs: list[RunData]) -> list[Reference]:
    """Return the untrained policy's evaluation of each agent, from its lowest seed that has one."""
    references: dict[tuple[str, str], Reference] = {}

    def order(run: RunData) -> tuple[Any, ...]:  # of one role, the most detail first
        role_and_agent = rank(run.config.role, run.config.agent)
        return (
            role_and_agent[0],
            -run.config.knows.rank,
            role_and_agent,
            run.config.seed,
        )

    for run in sorted(runs, key=order):
        agent = run.config.agent
        for label, evaluation in run.evaluations.items():
            if label.endswith(UNTRAINED):
                reference = Reference(f"untrained {agent}", [evaluation])
                references.setdefault((_task_key(run), agent), reference)
    return list(references.values())


def _label(runs: list[RunData]) -> str:
    """Return the most common evaluation of the best model; of equally common ones the greedy."""
    labels = Counter(label for run in runs for label in run.evaluations)
    others = (UNTRAINED, LATEST, HELD_OUT)
    best = sorted(label for label in labels if not label.endswith(others))
    return max(
        best, key=lambda label: (labels[label], label == PREFERRED_LABEL), default=""
    )


def _played(evaluation: Evaluation) -> tuple[dict[str, Any], str]:
    """Return what policies share that were evaluated on the same task by the same rules."""
    return _task_env(evaluation.summary.env), rules(evaluation)


def rules(evaluation: Evaluation) -> str:
    """Return what evaluations by the same rules share."""
    config = _without(to_dict(evaluation.summary.config), NOT_A_RULE)
    return json.dumps([evaluation.summary["episodes"], config], sort_keys=True)


EvaluationSet = dict[Group, list[Evaluation]]
"""Evaluations by the same rules, by agent."""


def evaluation_sets(task: TaskData) -> dict[tuple[str, str], EvaluationSet]:
    """Return the evaluations of the best models by label and rules."""
    sets: dict[tuple[str, str], EvaluationSet] = defaultdict(lambda: defaultdict(list))
    for group in task.groups:
        for run in group.runs:
            for label, evaluation in run.evaluations.items():
                if not label.endswith((UNTRAINED, LATEST)):
                    sets[label, rules(evaluation)][group].append(evaluation)
    return dict(sorted(sets.items(), key=lambda item: item[0][0]))


def split_groups(task: TaskData) -> dict[str, list[SplitGroup]]:
    """Return the agents of a task that chose between objects, by split.

    Without a split the queries are those of training (S1). The most common episodes count.
    """
    first, *_ = SPLITS
    by_split: dict[str, list[EvaluationSet]] = defaultdict(list)
    for evaluations in evaluation_sets(task).values():
        summary = next(iter(evaluations.values()))[0].summary
        if "choice_chance" in summary:
            by_split[summary.config.split or first].append(evaluations)
    groups = {}
    for split in SPLITS:
        if split in by_split:
            common = max(
                by_split[split], key=lambda agents: sum(map(len, agents.values()))
            )
            groups[split] = [
                SplitGroup(group.name, evaluations, group, split)
                for group, evaluations in common.items()
            ]
    return groups


def _comparable(
    runs: list[RunData], label: str, problems: list[FolderProblem]
) -> list[RunData]:
    """Drop evaluations on other episodes or with other thresholds than most."""
    rules_by_run = {
        run.path: rules(run.evaluations[label])
        for run in runs
        if label in run.evaluations
    }
    usual = _most_common(rules_by_run.values())
    kept = []
    for run in runs:
        if rules_by_run.get(run.path, usual) != usual:
            evaluations = dict(run.evaluations)
            folder = evaluations.pop(label).folder
            problems.append(
                FolderProblem(folder, OTHER_RULES, "the evaluation is left out")
            )
            run = replace(run, evaluations=evaluations)
        kept.append(run)
    return kept


def _one_run_per_seed(
    runs: list[RunData], problems: list[FolderProblem]
) -> list[RunData]:
    """Keep, of several runs of one seed, the one with the most steps, then the last by path."""
    chosen: dict[int, RunData] = {}
    for run in sorted(runs, key=lambda run: (run.steps_done, str(run.path))):
        seed = run.config.seed
        if seed in chosen:
            what = f"same agent, task and seed {seed} as {run.path}, which has no fewer steps"
            problems.append(FolderProblem(chosen[seed].path, what, "left out"))
        chosen[seed] = run
    return [chosen[seed] for seed in sorted(chosen)]


def _titles(tasks: list[list[RunData]]) -> list[tuple[str, str]]:
    """Return two titles per task, with names and for people; fields tell equal ones apart."""
    same_title: dict[tuple[str, ...], list[dict[str, Any]]] = defaultdict(list)
    for runs in tasks:
        same_title[_title(runs[0])].append(flatten(runs[0].settings["env"]))
    titles = []
    for runs in tasks:
        title = _title(runs[0])
        env = flatten(runs[0].settings["env"])
        robot, robot_title, *parts = title
        parts += [f"{field} {env.get(field)}" for field in differing(same_title[title])]
        titles.append((" · ".join([robot, *parts]), " · ".join([robot_title, *parts])))
    return titles


def _title(run: RunData) -> tuple[str, ...]:
    """Return what the titles of a run's task consist of: the robot, its title, and the rest."""
    env = run.config.env
    robot_title = ROBOTS[env.robot].title if env.robot in ROBOTS else env.robot
    title = (
        env.robot,
        robot_title,
        env.task.title,
        f"{env.colours} colours",
        run.config.learner,
    )
    return tuple(filter(None, title))


def _report_versions(runs: list[RunData], problems: list[FolderProblem]) -> None:
    """Report the runs that were made with another version of the package than most."""
    versions = {run.path: run.provenance.versions.get("knowarm") for run in runs}
    usual = _most_common(filter(None, versions.values()))
    for path, version in versions.items():
        if version and version != usual:
            what = f"made with knowarm {version}, most runs with {usual}"
            problems.append(
                FolderProblem(path, what, "merged: the run format is the same")
            )


def _most_common(values: Iterable[str]) -> str | None:
    """Return the most common value; of equally common ones the first by name."""
    counts = Counter(sorted(values))
    return max(counts, key=lambda value: counts[value], default=None)


def _task_key(run: RunData) -> str:
    """Return a key that is equal for runs on the same task with the same algorithm."""
    return json.dumps(
        [_task_env(run.settings["env"]), run.config.learner], sort_keys=True
    )


def _task_env(env: Mapping[str, Any]) -> dict[str, Any]:
    """Return what makes the task of an environment."""
    task_env = _without(env, NOT_THE_TASK)
    task = env.get("task")
    if isinstance(task, dict) and isinstance(task.get("asked"), dict):
        task_env["task"] = task | {"asked": _without(task["asked"], NOT_A_TASK)}
    return task_env


def _agent_settings(run: RunData) -> dict[str, Any]:
    """Return everything but task and seed, flattened to dotted names."""
    settings = _without(run.settings, NOT_A_SETTING)
    env = run.settings["env"] | run.settings["env"]["task"]["asked"]
    settings["env"] = {
        name: env[name] for name in NOT_THE_TASK | NOT_A_TASK if name in env
    }
    return _without(flatten(settings), DRAWS)


def _without(values: Mapping[str, Any], names: Collection[str]) -> dict[str, Any]:
    return {name: value for name, value in values.items() if name not in names}
