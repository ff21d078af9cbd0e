"""Page "Paper": accuracy and learning time beside the published results."""

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from knowarm.report import format
from knowarm.report.blocks import Block, Column, Figure, Panel, Row, Table, Text, cells, shared
from knowarm.report.charts import Axis
from knowarm.report.diagrams import dot_chart, group_dot
from knowarm.report.study import Group, Study, Task
from knowarm.statistics import Interval, bootstrap

RESULTS = Path(__file__).parents[1] / "paper_results.json"
"""The published numbers; ``about`` in the file explains its fields."""

ACCURACY_AXIS = Axis(title="accuracy", format=format.whole_percent, range=(0.0, 1.0))


EXPLANATION = (
    "Accuracy is defined as in the paper: the fraction of episodes whose final distance is within "
    "the threshold, whatever the angle. The learning time saved compares the steps of the best "
    "models, as the paper does. The best model is the maximum of noisy evaluations; its step "
    "varies by tens of per cent between seeds. The page Training has the steps to fixed levels of "
    "success instead."
)


@cache
def _published() -> dict[str, Any]:
    return json.loads(RESULTS.read_text(encoding="utf-8"))


def published_result(task: Task, agent: str) -> Mapping[str, float] | None:
    """Return the published accuracy and step of the best model of an agent."""
    key = (*task.key, agent)
    found = (r for r in _published()["results"] if (r["robot"], r["colours"], r["agent"]) == key)
    return next(found, None)


def published_comparison(task: Task, first: Group, second: Group) -> Mapping[str, Any]:
    """Return the published F value and changes in joint angles of two agents; empty if none."""
    for each in _published()["comparisons"]:
        agents = (each["first"], each["second"])
        if (each["robot"], each["colours"]) == task.key and agents == (first.agent, second.agent):
            return each
    return {}


def time_saved(steps: float | None, baseline_steps: float | None) -> float | None:
    """Return the fraction of the baseline's steps that an agent saved; None if one is unknown.

    This is how the paper computes learning time: 20 % for TIAGo without randomization (it states
    25 %, which is 60 / 48 - 1) and 57 to 58 % with randomization.
    """
    return 1 - steps / baseline_steps if steps and baseline_steps else None


def paper_blocks(study: Study) -> list[Block]:
    """Show accuracy, step of the best model and learning time, measured and published."""
    tasks = [t for t in study.tasks if any(published_result(t, g.agent) for g in t.groups)]
    return [_figure(tasks), Text(paragraphs=[EXPLANATION])] if tasks else []


def _figure(tasks: list[Task]) -> Figure:
    rows: list[Row] = []
    panels = []
    for task in tasks:
        dots = []
        for group in task.groups:
            published = published_result(task, group.agent)
            if published is None:
                continue
            rows.append(_row(task, group, published))
            dots.append(group_dot(group, "accuracy", task.colours, published["accuracy"]))
        name = f"Accuracy on {task.title}, measured and published"
        panels.append(Panel(svg=dot_chart(dots, name, ACCURACY_AXIS), title=task.title))
    return Figure(
        title="Accuracy after training",
        caption="Dot and line: this report, with its 95 % interval. Small dots: training seeds. "
        "Ring: the paper.",
        panels=panels,
        table=Table(
            name="paper",
            title="Accuracy and learning time",
            columns=[
                *shared("task", "agent", "seeds", "accuracy"),
                Column("paper_accuracy", "paper", "percent"),
                Column("best_step", "best model at", "steps", interval=True),
                Column("paper_step", "paper", "steps"),
                Column("saved", "learning time saved", "percent"),
                Column("paper_saved", "paper", "percent"),
            ],
            rows=rows,
            sources=[run.path for task in tasks for run in task.runs],
            note="Paper: section 5.2, table of experiments.",
        ),
        open_table=True,
    )


def _row(task: Task, group: Group, published: Mapping[str, float]) -> Row:
    own, baseline = _best_steps(group), _best_steps(task.baseline)
    base = published_result(task, _published()["baseline"])
    compared = group is not task.baseline
    return {
        "task": task.title,
        "agent": group.name,
        "seeds": len(group.evaluations),
        **cells("accuracy", group.level("accuracy")),
        "paper_accuracy": published["accuracy"],
        **cells("best_step", own),
        "paper_step": published["best_step"],
        "saved": time_saved(own.estimate, baseline.estimate)
        if own and baseline and compared
        else None,
        "paper_saved": time_saved(published["best_step"], base["best_step"])
        if base and base is not published
        else None,
        "_colour": task.colours[group.name],
    }


def _best_steps(group: Group | None) -> Interval | None:
    """Estimate the mean step of the best interim model over training seeds."""
    steps = [run.best_step for run in group.runs if run.best_step] if group else []
    return bootstrap([np.array(steps)]) if steps else None
