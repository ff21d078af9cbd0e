"""Page `docs/results/answer-a3c.md` on the paper's algorithm with other numbers."""

from collections.abc import Sequence
from pathlib import Path

from knowarm.report.collect import collect
from knowarm.report.model import Group
from scripts.answer_cells import (
    cells_of,
    never,
    percent,
    table,
    thousands,
    title_of,
    verdict,
)

TUNED = """**Protocol.** Study `a3c-tuned`, whose numbers
[differ](../reference/algorithms.md#a3c) from the paper's: IRB120, {total} million steps, training
{seeds}, interim evaluations every {every:,} steps. {progress}"""


def a3c_page(study: Path, progress: str) -> list[str]:
    """Return the blocks of the page from an unpacked study, and what is done of it."""
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
    groups = [group for cell in cells for group in cell.task.groups]
    lines = [*map(verdict, cells), f"Blind, at most: {blind_agents(groups)}."]
    reached = span([float(agent.success.mean()) for agent in every])
    lead = (
        f"**With other numbers than the paper's, A3C succeeds in {reached} of the episodes after "
        f"{total // 10**6} million steps.**"
    )
    listed = "\n".join(f"- {line}" for line in lines)
    rest = [text, figure, table(columns, rows), listed]
    return ["# A3C with settings that learn", lead, *rest]


def span(shares: Sequence[float]) -> str:
    """Return the least and the largest of some shares in percent."""
    return f"{100 * min(shares):.1f} to {100 * max(shares):.1f} %"


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
