"""Page `docs/results/answer-a3c.md` on the paper's algorithm."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from knowarm.report.collect import collect
from knowarm.report.model import Group, TaskData
from scripts.answer_cells import (
    cells_of,
    never,
    percent,
    table,
    thousands,
    title_of,
    verdict,
)

ROWS = 100
"""Rows of the metrics whose mean is the success of the last training episodes."""

TEXT = """**Protocol.** Study `a3c`: IRB120, fixed colours, the paper's numbers, but two workers of
32 environments instead of 17 of one, so {updates:,} updates of {batch:,} steps instead of 1.4
million of at most 50; seed 0, {total} million steps; 1,000 episodes after training (10 cm, 17
degrees). {progress}"""

TUNED = """**Protocol.** Study `a3c-tuned`, whose numbers
[differ](../reference/algorithms.md#a3c) from the paper's: IRB120, {total} million steps, training
{seeds}, interim evaluations every {every:,} steps. {progress}"""


def tuned_section(study: Path, progress: str) -> tuple[str, list[str]]:
    """Return what A3C with settings that learn reaches, and its blocks, from a study."""
    cells = cells_of([collect([study])])
    every = [agent for cell in cells for agent in cell.agents.values()]
    (total,) = {run.config.total_steps for cell in cells for run in cell.task.runs}
    (between,) = {
        run.config.interim.every_steps for cell in cells for run in cell.task.runs
    }
    seeds = sorted({seed for each in every for seed in each.seeds})
    text = TUNED.format(
        total=total // 10**6,
        seeds=f"seed{'s' * (len(seeds) > 1)} {', '.join(map(str, seeds))}",
        progress=progress,
        every=between,
    )
    figure = "![Interim success of `a3c-tuned`, fixed colours](../images/a3c-curve.svg)"
    rows = [
        [
            title_of(cell.task),
            f"`{name}`",
            thousands(agent.steps) + never(agent),
            percent(agent.success),
        ]
        for cell in cells
        for name, agent in cell.agents.items()
    ]
    columns = ["cell", "agent", "steps to 80 % [thousands]", "success"]
    blocks = ["## A3C with settings that learn", text, figure, table(columns, rows)]
    groups = [group for cell in cells for group in cell.task.groups]
    lines = [*map(verdict, cells), f"Blind, at most: {blind_agents(groups)}."]
    reached = span([float(agent.success.mean()) for agent in every])
    return (
        f"{reached} after {total // 10**6} million",
        [*blocks, "\n".join(f"- {line}" for line in lines)],
    )


def span(shares: Sequence[float]) -> str:
    """Return the least and the largest of some shares in percent."""
    return f"{100 * min(shares):.1f} to {100 * max(shares):.1f} %"


def a3c_page(study: Path, tuned: Path, states: Sequence[str]) -> list[str]:
    """Return the blocks of the page from two unpacked studies, and what is done of each."""
    (task,) = collect([study]).tasks
    reached, more = tuned_section(tuned, states[1])
    finals = [
        float(run.evaluations[group.label].summary["success"])
        for group in task.groups
        for run in group.runs
    ]
    progress = states[0]
    total = max(run.config.total_steps for run in task.runs)
    algorithm = task.runs[0].settings["algorithm"]
    batch = algorithm["envs_per_worker"] * algorithm["rollout_steps"]
    text = TEXT.format(
        batch=batch,
        updates=total // batch,
        total=total // 10**6,
        progress=progress,
    )
    lead = (
        f"**The paper's algorithm with the paper's numbers succeeds in {span(finals)} of 1,000 "
        f"episodes after {total // 10**6} million steps, with other numbers in {reached}.**"
    )
    numbers = [text, conclusion(task)]
    return ["# The paper's algorithm", lead, *numbers, *more]


def blind_agents(groups: Sequence[Group]) -> str:
    """Say what agents that see nothing reach, the most of all runs of some groups."""
    runs = (run.evaluations.get(group.label) for group in groups for run in group.runs)
    found = [each.summary for each in runs if each]
    listed, black, first = (
        f"{100 * max(each.interval('success', 'blind', name).estimate for each in found):.1f} %"
        for name in ("open-loop", "blind", "frozen")
    )
    return (
        f"the best list of actions reaches {listed}, the network on black images {black}, and on "
        f"the first image only {first}"
    )


def conclusion(task: TaskData) -> str:
    """Say what the finished trainings reached."""
    lines = []
    for group in task.groups:
        for run in group.runs:
            if run.steps_done < 0.98 * run.config.total_steps:
                continue
            final = run.evaluations.get(group.label)
            trained = run.metrics["success"][-ROWS:]
            share = f"{100 * np.nanmean(trained):.1f} %"
            line = f"- `{group.name}`: {share} of its last training episodes"
            if final:
                line += f", {100 * final.summary['success']:.1f} % after training"
            lines.append(f"{line}.")
    lines.append(f"- Blind, at most: {blind_agents(task.groups)}.")
    if all(len(group.runs) == 1 for group in task.groups) and len(task.groups) > 1:
        lines.append(
            "- One training seed each, no control: nothing about the knowledge follows."
        )
    return "\n".join(lines)
