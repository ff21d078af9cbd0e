"""Joint angles of two agents on the same episodes go in; their distributions come out."""

import numpy as np

from knowarm.errors import UserError
from knowarm.report import format
from knowarm.report.blocks import Column, Figure, Page, Panel, Row, Table, Verdict
from knowarm.report.claims import subject
from knowarm.report.figures import Density, densities, density_chart
from knowarm.report.palette import colours
from knowarm.report.paper import STD_CHANGES
from knowarm.report.study import Group, Judged, Study, Task


def joints_page(study: Study) -> Page:
    """Where two agents moved each joint, and how widely (paper sections 5.1 and 5.2)."""
    page = Page(
        name="joints",
        short="Joints",
        title="Joint angles",
        lead="Angles of every step of the evaluation: each agent's best run.",
    )
    for task in study.tasks:
        pair = _pair(task)
        if pair is None:
            continue
        try:
            page.add(task, [_figure(task, *pair)])
        except UserError as error:
            page.add(task, [Verdict(sentence=str(error), tone="bad")])
    return page


def _pair(task: Task) -> tuple[Group, Group] | None:
    """The knowledge agent and the baseline, or else the first two agents, with kept steps."""
    kept = [group for group in task.groups if (judged := _judged(group)) and judged.has_steps]
    asked = subject(task)
    baseline = next((group for group in kept if group.agent == "bm"), None)
    if asked in kept and baseline:
        return asked, baseline
    return (kept[0], kept[1]) if len(kept) > 1 else None


def _judged(group: Group) -> Judged | None:
    run = group.best_run()
    return run.judged[group.label] if run and group.label else None


def _figure(task: Task, first: Group, second: Group) -> Figure:
    chosen = colours(group.name for group in task.groups)
    evaluations = [judged for group in (first, second) if (judged := _judged(group))]
    samples = [judged.steps() for judged in evaluations]
    joints = sorted(
        (name for name in samples[0] if name.startswith("joint_") and name in samples[1]),
        key=lambda name: int(name.split("_")[1]),
    )
    published = STD_CHANGES.get((task.robot, task.colours), {})
    comparable = {first.agent, second.agent} == {"full", "bm"}
    rows: list[Row] = []
    panels = []
    for name in joints:
        number = int(name.split("_")[1])
        angles = [each[name].astype(np.float64) for each in samples]
        means, spreads = [float(a.mean()) for a in angles], [float(a.std()) for a in angles]
        rows.append(
            {
                "joint": number,
                "first_mean": means[0],
                "second_mean": means[1],
                "mean_change": means[0] - means[1],
                "first_std": spreads[0],
                "second_std": spreads[1],
                "std_change": spreads[0] - spreads[1],
                "paper_std_change": published.get(number) if comparable else None,
            }
        )
        edges, heights = densities(angles)
        shown = [
            Density(name=group.name, colour=chosen[group.name], heights=height, mean=mean)
            for group, height, mean in zip((second, first), heights[::-1], means[::-1], strict=True)
        ]
        title = (
            f"joint {number}: mean {format.signed(means[0] - means[1])}, "
            f"std {format.signed(spreads[0] - spreads[1])}"
        )
        svg = density_chart(shown, edges, f"Angles of joint {number}", x_title="angle [rad]")
        panels.append(Panel(svg=svg, title=title))
    label = {0: first.name, 1: second.name}
    return Figure(
        title=f"Joint angles of {first.name} and {second.name}: {task.title}",
        caption=f"Above each: {first.name} minus {second.name} [rad]. Dashed: means. One trained "
        "network each: another training seed may move them as much as the knowledge does.",
        panels=panels,
        legend=[(group.name, chosen[group.name]) for group in (first, second)],
        table=Table(
            name=f"joints-{task.name}",
            title="Mean and standard deviation of every joint [rad]",
            columns=[
                Column(key="joint", label="joint", format="integer"),
                Column(key="first_mean", label=f"{label[0]} mean", format="number"),
                Column(key="second_mean", label=f"{label[1]} mean", format="number"),
                Column(key="mean_change", label="difference", format="signed"),
                Column(key="first_std", label=f"{label[0]} std", format="number"),
                Column(key="second_std", label=f"{label[1]} std", format="number"),
                Column(key="std_change", label="difference", format="signed"),
                Column(key="paper_std_change", label="paper's", format="signed"),
            ],
            rows=rows,
            sources=[judged.folder / "steps.parquet" for judged in evaluations],
        ),
    )
