"""Page "Paper": accuracy and learning time beside the published results."""

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from knowarm.config import to_dict
from knowarm.learn.algorithms import privileged_uses
from knowarm.report.blocks import (
    Block,
    Figure,
    Text,
    row_of,
    table_of,
)
from knowarm.report.charts import percent_axis
from knowarm.report.diagrams import dot_panels
from knowarm.report.model import Group, StudyData, TaskData, evaluated_runs
from knowarm.statistics import Interval, bootstrap

# ``about`` in it explains the fields.
RESULTS = Path(__file__).parents[1] / "paper_results.json"

ACCURACY_AXIS = percent_axis("accuracy")

EXPLANATION = (
    "Accuracy is defined as in the paper: the fraction of episodes whose final distance is within "
    "the threshold, whatever the angle. The best model is the maximum of noisy evaluations, so its "
    "step varies by tens of per cent between seeds: the page Training compares the steps to fixed "
    "levels of success instead. Simulator, start poses and learning algorithm differ from the "
    "paper's: a ring beside a dot is for orientation."
)


@cache
def _published() -> dict[str, Any]:
    return json.loads(RESULTS.read_text(encoding="utf-8"))


def published_result(task: TaskData, agent: str) -> Mapping[str, float] | None:
    """Return the published accuracy and step of the best model of an agent."""
    return _find(task, "results", agent=agent)


def published_comparison(
    task: TaskData,
    first: Group,
    second: Group,
) -> Mapping[str, Any]:
    """Return the published F value and changes in joint angles of two agents; empty if none."""
    return _find(task, "comparisons", first=first.agent, second=second.agent) or {}


def _find(task: TaskData, kind: str, **agents: str) -> Mapping[str, Any] | None:
    """Return what the paper publishes of agents on a task.

    Nothing on tasks that are not the paper's, or were not learned from its reward.
    """
    config = task.groups[0].config
    if config.env.task.title or "teacher" in privileged_uses(to_dict(config.algorithm)):
        return None
    robot, colours = task.key
    wanted = {"robot": robot, "colours": colours} | agents
    for entry in _published()[kind]:
        if wanted.items() <= entry.items():
            return entry
    return None


def time_saved(steps: float | None, baseline_steps: float | None) -> float | None:
    """Return the fraction of the baseline's steps that an agent saved; None if one is unknown.

    As in the paper: 20 % for TIAGo in fixed colours (it states 25 %, 60 / 48 - 1).
    """
    if not steps or not baseline_steps:
        return None
    return 1 - steps / baseline_steps


def paper_blocks(study: StudyData) -> list[Block]:
    """Show accuracy, step of the best model and learning time, measured and published."""
    rows = []
    for task in study.tasks:
        for group in task.groups:
            published = published_result(task, group.agent)
            if published:
                row = row_of(group, "accuracy") | {
                    "task": task.title,
                    "_panel": task.title,
                    "paper_accuracy": published["accuracy"],
                    "best_step": _best_steps(group),
                    "paper_step": published["best_step"],
                }
                rows.append(row)
    if not rows:
        return []
    table = table_of(study, "paper", rows)
    panels = dot_panels(table, "accuracy", ACCURACY_AXIS, seeds=True)
    return [Figure(table, panels, open_table=True), Text([EXPLANATION])]


def _best_steps(group: Group) -> Interval | None:
    """Estimate the mean step of the best interim model over training seeds."""
    runs = evaluated_runs(group.runs, group.label)
    steps = [run.best_step for run in runs if run.best_step]
    return bootstrap(np.array(steps)) if steps else None
