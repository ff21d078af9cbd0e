"""Page "Paper": accuracy and learning time beside the published results."""

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from knowarm.report.blocks import (
    Block,
    Column,
    DataTable,
    Figure,
    Panel,
    Row,
    Text,
    row_of,
    shared,
)
from knowarm.report.charts import percent_axis
from knowarm.report.diagrams import dot_chart, group_dot
from knowarm.report.model import Group, StudyData, TaskData
from knowarm.statistics import Interval, bootstrap

RESULTS = Path(__file__).parents[1] / "paper_results.json"  # ``about`` in it explains the fields

ACCURACY_AXIS = percent_axis("accuracy")

COLUMNS = (
    Column("paper_accuracy", "paper", "percent"),
    Column("best_step", "best model at", "steps", interval=True),
    Column("paper_step", "paper", "steps"),
)

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
    key = (*task.key, agent)
    results = _published()["results"] if task.is_published else []
    found = (r for r in results if (r["robot"], r["colours"], r["agent"]) == key)
    return next(found, None)


def published_comparison(task: TaskData, first: Group, second: Group) -> Mapping[str, Any]:
    """Return the published F value and changes in joint angles of two agents; empty if none."""
    for each in _published()["comparisons"] if task.is_published else []:
        agents = (each["first"], each["second"])
        if (each["robot"], each["colours"]) == task.key and agents == (first.agent, second.agent):
            return each
    return {}


def time_saved(steps: float | None, baseline_steps: float | None) -> float | None:
    """Return the fraction of the baseline's steps that an agent saved; None if one is unknown.

    As in the paper: 20 % for TIAGo in fixed colours (it states 25 %, 60 / 48 - 1).
    """
    return 1 - steps / baseline_steps if steps and baseline_steps else None


def paper_blocks(study: StudyData) -> list[Block]:
    """Show accuracy, step of the best model and learning time, measured and published."""
    tasks = [t for t in study.tasks if any(published_result(t, g.agent) for g in t.groups)]
    return [_figure(tasks), Text(paragraphs=[EXPLANATION])] if tasks else []


def _figure(tasks: list[TaskData]) -> Figure:
    rows: list[Row] = []
    panels = []
    for task in tasks:
        dots = []
        for group in task.groups:
            if published := published_result(task, group.agent):
                row: Row = {"task": task.title, "best_step": _best_steps(group)}
                row |= row_of(task, group, "accuracy")
                row["paper_accuracy"] = published["accuracy"]
                rows.append(row | {"paper_step": published["best_step"]})
                dots.append(group_dot(group, "accuracy", task.colours, published["accuracy"]))
        name = f"Accuracy on {task.title}, measured and published"
        panels.append(Panel(svg=dot_chart(dots, name, ACCURACY_AXIS), title=task.title))
    return Figure(
        table=DataTable(
            name="paper",
            title="Accuracy and learning time",
            columns=shared("task", "agent", "seeds", "accuracy", *COLUMNS),
            rows=rows,
            sources=[run.path for task in tasks for run in task.runs],
            note="Paper: Boosting Deep Reinforcement Learning with Semantic Knowledge for Robotic "
            "Manipulators, Robotics 2025, 14, 86, doi.org/10.3390/robotics14070086, section 5.2.",
        ),
        caption="Dot and line: this report, with its 95 % interval. Small dots: training seeds. "
        "Ring: the paper, with another simulator, other start poses and another algorithm.",
        panels=panels,
        open_table=True,
    )


def _best_steps(group: Group) -> Interval | None:
    """Estimate the mean step of the best interim model over training seeds."""
    runs = [run for run in group.runs if group.label in run.evaluations]
    steps = [run.best_step for run in runs if run.best_step]
    return bootstrap(np.array(steps)) if steps else None
