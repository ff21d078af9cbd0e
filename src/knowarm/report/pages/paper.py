"""Runs go in; the paper's table of experiments beside the paper's own numbers comes out."""

import numpy as np

from knowarm.report import format
from knowarm.report.blocks import Column, Figure, Page, Panel, Row, Table, Text
from knowarm.report.figures import Dot, dot_chart
from knowarm.report.levels import cells, level
from knowarm.report.palette import colours
from knowarm.report.paper import RESULTS, learning_time_reduction
from knowarm.report.study import Group, Study, Task
from knowarm.statistics import Interval, bootstrap


def paper_page(study: Study) -> Page:
    """Accuracy, best-model step and learning time, ours and the paper's."""
    page = Page(
        name="paper",
        short="Paper",
        title="Beside the paper",
        lead="The paper's numbers come from one training seed an agent, A3C and 70 M steps.",
    )
    tasks = [task for task in study.tasks if any(_paper(task, g) for g in task.groups)]
    if not tasks:
        return page
    page.blocks.append(_figure(tasks))
    page.blocks.append(
        Text(
            paragraphs=[
                "Accuracy is the paper's: the share of episodes whose final distance is within "
                "the threshold, whatever the angle. The saved share of learning time compares the "
                "steps of the best models, as the paper does: a maximum over noisy evaluations, "
                "which moves by tens of per cent from seed to seed. The page of differences gives "
                "the steps to fixed success levels instead."
            ]
        )
    )
    return page


def _paper(task: Task, group: Group) -> object:
    return RESULTS.get((task.robot, task.colours, group.agent))


def _figure(tasks: list[Task]) -> Figure:
    rows: list[Row] = []
    panels = []
    for task in tasks:
        chosen = colours(group.name for group in task.groups)
        baseline = next((group for group in task.groups if group.agent == "bm"), None)
        dots = []
        for group in task.groups:
            published = RESULTS.get((task.robot, task.colours, group.agent))
            if published is None:
                continue
            base = RESULTS.get((task.robot, task.colours, "bm"))
            accuracy, steps = level(group, "accuracy"), best_steps(group)
            base_steps = best_steps(baseline) if baseline and baseline is not group else None
            rows.append(
                {
                    "task": task.title,
                    "agent": group.name,
                    "seeds": len(group.judged_runs),
                    "paper_accuracy": published.accuracy,
                    "paper_step": published.best_step,
                    "saved": learning_time_reduction(
                        steps.estimate if steps else None,
                        base_steps.estimate if base_steps else None,
                    ),
                    "paper_saved": learning_time_reduction(published.best_step, base.best_step)
                    if base and group.agent != "bm"
                    else None,
                    "_colour": chosen[group.name],
                }
                | cells("accuracy", accuracy)
                | cells("best_step", steps)
            )
            dots.append(
                Dot(
                    name=group.name,
                    colour=chosen[group.name],
                    value=accuracy.estimate if accuracy else None,
                    low=accuracy.low if accuracy else None,
                    high=accuracy.high if accuracy else None,
                    single=group.scores("accuracy").tolist() if len(group.judged_runs) > 1 else [],
                    beside=published.accuracy,
                )
            )
        svg = dot_chart(
            dots,
            f"Accuracy on {task.title}, ours and the paper's",
            x_title="accuracy",
            x_format=lambda value: format.percent(value, 0),
            x_range=(0, 1),
        )
        panels.append(Panel(svg=svg, title=task.title))
    columns = [
        Column(key="task", label="task"),
        Column(key="agent", label="agent"),
        Column(key="seeds", label="seeds", format="integer"),
        Column(key="accuracy", label="accuracy", format="percent", interval=True),
        Column(key="paper_accuracy", label="paper", format="percent"),
        Column(key="best_step", label="best model at", format="steps", interval=True),
        Column(key="paper_step", label="paper", format="steps"),
        Column(key="saved", label="learning time saved", format="percent"),
        Column(key="paper_saved", label="paper", format="percent"),
    ]
    return Figure(
        title="Accuracy after training",
        caption="Dot and line: ours with its 95 % interval. Small dots: training seeds. Ring: the "
        "paper.",
        panels=panels,
        table=Table(
            name="paper",
            title="The paper's table of experiments",
            columns=columns,
            rows=rows,
            sources=[run.path for task in tasks for run in task.runs],
            note="Paper: section 5.2, table of experiments.",
        ),
        open_table=True,
    )


def best_steps(group: Group | None) -> Interval | None:
    """Mean step of the best interim model over training seeds."""
    steps = [run.best_step for run in group.runs if run.best_step] if group else []
    return bootstrap([np.array(steps)]) if steps else None
