"""Collection of a study: sorts runs and evaluations into tasks and agents."""

import json
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
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
UNTRAINED, LATEST, HELD_OUT = "-untrained", "-latest", "-held-out"
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


def collect(paths: Sequence[Path]) -> StudyData:
    """Read run folders, at any depth, and sort them into tasks and agents."""
    runs, problems = read_folders(paths)
    references = _untrained(runs)
    by_task: dict[str, list[RunData]] = defaultdict(list)
    for run in runs:
        by_task[_task_key(run)].append(run)
    titles = _titles(list(by_task.values()))
    names = slugs(ids for ids, _ in titles)
    tasks = [
        _task((names[ids], title), members, references, problems)
        for (ids, title), members in zip(titles, by_task.values(), strict=True)
    ]
    _report_versions(runs, problems)
    return StudyData(
        tuple(sorted(tasks, key=lambda task: task.title)),
        tuple(sorted(problems, key=lambda problem: str(problem.path))),
    )


def _task(
    names: tuple[str, str],
    runs: list[RunData],
    references: list[Reference],
    problems: list[FolderProblem],
) -> TaskData:
    label = _label(runs)
    runs = _comparable(runs, label, problems)
    by_agent: dict[str, list[RunData]] = defaultdict(list)
    for run in runs:
        by_agent[run.config.agent].append(run)
    groups: list[Group] = []
    for agent, same_agent in by_agent.items():
        settings = [_agent_settings(run) for run in same_agent]
        fields = differing(settings)
        members: dict[str, list[RunData]] = defaultdict(list)
        for run, values in zip(same_agent, settings, strict=True):
            details = [f"{field.split('.')[-1]}={values.get(field)}" for field in fields]
            members[" · ".join([agent, *details])].append(run)
        for name, chosen in members.items():
            groups.append(Group.of(name, _one_run_per_seed(chosen, problems), label))
    own = next((run.evaluations[label] for run in runs if label in run.evaluations), None)
    fitting = [each for each in references if own and _same_rules(each.evaluations[0], own)]
    groups.sort(key=lambda group: rank(group.role, group.agent))
    return TaskData(*names, label, tuple(groups), tuple(fitting[:2]))  # enough to compare with


def _untrained(runs: list[RunData]) -> list[Reference]:
    """Return the untrained policy's evaluation of each agent, from its lowest seed that has one."""
    references: dict[tuple[str, str], Reference] = {}

    def order(run: RunData) -> tuple[Any, ...]:  # of one role, the most detail first
        ranked = rank(run.config.role, run.config.agent)
        return ranked[0], -run.config.knows.rank, ranked, run.config.seed

    for run in sorted(runs, key=order):
        for label, evaluation in run.evaluations.items():
            if label.endswith(UNTRAINED):
                reference = Reference(f"untrained {run.config.agent}", [evaluation])
                references.setdefault((_task_key(run), run.config.agent), reference)
    return list(references.values())


def _label(runs: list[RunData]) -> str:
    """Return the most common evaluation of the best model; of equally common ones the greedy."""
    labels = (label for run in runs for label in run.evaluations)
    counts = Counter(label for label in labels if not label.endswith((UNTRAINED, LATEST, HELD_OUT)))
    return max(sorted(counts), key=lambda n: (counts[n], n == PREFERRED_LABEL), default="")


def _same_rules(first: Evaluation, second: Evaluation) -> bool:
    """Return whether two policies were evaluated on the same task by the same rules."""
    env, other_env = (_task_env(each.summary.env) for each in (first, second))
    return env == other_env and rules(first) == rules(second)


def rules(evaluation: Evaluation) -> str:
    """Return what evaluations by the same rules share."""
    config = to_dict(evaluation.summary.config)
    kept = {k: v for k, v in config.items() if k not in NOT_A_RULE}
    return json.dumps([evaluation.summary["episodes"], kept], sort_keys=True)


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
    return dict(sorted(sets.items(), key=lambda each: each[0][0]))


def split_groups(task: TaskData) -> dict[str, list[SplitGroup]]:
    """Return the agents of a task that chose between objects, by split.

    Without a split the queries are those of training (S1). The most common episodes count.
    """
    by_split: dict[str, list[EvaluationSet]] = defaultdict(list)
    for evaluations in evaluation_sets(task).values():
        summary = next(iter(evaluations.values()))[0].summary
        if "choice_chance" in summary:
            split: str = summary.config.split or next(iter(SPLITS))
            by_split[split].append(evaluations)
    return {
        split: [
            SplitGroup(group.name, evaluations, group, split)
            for group, evaluations in max(
                by_split[split], key=lambda each: sum(map(len, each.values()))
            ).items()
        ]
        for split in filter(by_split.__contains__, SPLITS)
    }


def _comparable(runs: list[RunData], label: str, problems: list[FolderProblem]) -> list[RunData]:
    """Drop evaluations on other episodes or with other thresholds than most."""
    rules_by_run = {
        run.path: rules(run.evaluations[label]) for run in runs if label in run.evaluations
    }
    usual = _most_common(rules_by_run.values())
    kept = []
    for run in runs:
        if label and rules_by_run.get(run.path, usual) != usual:
            what = "evaluated on other episodes or with other thresholds than most runs of its task"
            folder = run.evaluations[label].folder
            problems.append(FolderProblem(folder, what, "the evaluation is left out"))
            others = {name: each for name, each in run.evaluations.items() if name != label}
            run = replace(run, evaluations=others)
        kept.append(run)
    return kept


def _one_run_per_seed(runs: list[RunData], problems: list[FolderProblem]) -> tuple[RunData, ...]:
    """Keep, of several runs of one seed, the one with the most steps, then the last by path."""
    chosen: dict[int, RunData] = {}
    for run in sorted(runs, key=lambda run: (run.steps_done, str(run.path))):
        seed = run.config.seed
        if (other := chosen.get(seed)) is not None:
            what = f"same agent, task and seed {seed} as {run.path}, which has no fewer steps"
            problems.append(FolderProblem(other.path, what, "left out"))
        chosen[seed] = run
    return tuple(chosen[seed] for seed in sorted(chosen))


def _titles(tasks: list[list[RunData]]) -> list[tuple[str, str]]:
    """Return two titles per task, with names and for people; fields tell equal ones apart."""
    short = []
    for runs in tasks:
        env = runs[0].config.env
        title = ROBOTS[env.robot].title if env.robot in ROBOTS else env.robot
        rest = [*filter(None, [env.task.title]), f"{env.colours} colours", runs[0].config.learner]
        short.append((" · ".join([env.robot, *rest]), " · ".join([title, *rest])))
    titles = []
    for both, runs in zip(short, tasks, strict=True):
        envs = [flatten(each[0].settings["env"]) for each in tasks]
        alike = [each for other, each in zip(short, envs, strict=True) if other == both]
        own = flatten(runs[0].settings["env"])
        details = [f"{name} {own.get(name)}" for name in differing(alike)]
        titles.append((" · ".join([both[0], *details]), " · ".join([both[1], *details])))
    return titles


def _report_versions(runs: list[RunData], problems: list[FolderProblem]) -> None:
    """Report the runs that were made with another version of the package than most."""
    versions = {run.path: run.provenance.versions.get("knowarm") for run in runs}
    usual = _most_common(filter(None, versions.values()))
    for path, version in versions.items():
        if version and version != usual:
            what = f"made with knowarm {version}, most runs with {usual}"
            problems.append(FolderProblem(path, what, "merged: the run format is the same"))


def _most_common(values: Any) -> Any:
    counts = Counter(values)
    return max(sorted(counts), key=lambda value: counts[value], default=None)


def _task_key(run: RunData) -> str:
    """Return a key that is equal for runs on the same task with the same algorithm."""
    return json.dumps([_task_env(run.settings["env"]), run.config.learner], sort_keys=True)


def _task_env(env: Mapping[str, Any]) -> dict[str, Any]:
    """Return what makes the task of an environment."""
    env = {name: value for name, value in env.items() if name not in NOT_THE_TASK}
    task = env.get("task")
    if isinstance(task, dict) and isinstance(task.get("asked"), dict):
        asked = {name: value for name, value in task["asked"].items() if name not in NOT_A_TASK}
        env["task"] = task | {"asked": asked}
    return env


def _agent_settings(run: RunData) -> dict[str, Any]:
    """Return everything but task and seed, flattened to dotted names."""
    kept = {name: value for name, value in run.settings.items() if name not in NOT_A_SETTING}
    env = run.settings["env"] | run.settings["env"]["task"]["asked"]
    kept["env"] = {name: env[name] for name in NOT_THE_TASK | NOT_A_TASK if name in env}
    return {name: value for name, value in flatten(kept).items() if name not in DRAWS}
