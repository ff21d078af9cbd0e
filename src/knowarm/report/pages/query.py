"""Page "Query": which object each agent chose, by split and by kind of query."""

from collections.abc import Sequence
from itertools import chain

from knowarm.knowledge.queries.splits import SPLITS
from knowarm.report.blocks import (
    Block,
    DataTable,
    Figure,
    Row,
    row_of,
    table_of,
)
from knowarm.report.charts import CHOICE_AXIS, percent_axis
from knowarm.report.diagrams import dot_panels
from knowarm.report.format import facet
from knowarm.report.model import Group, TaskData
from knowarm.report.pages.training import curve_figure
from knowarm.report.verdicts.claims import ALPHA, FEWEST_SEEDS, Finding

EXPLANATION = (
    "Several objects are visible, and a query describes one of them by facts of a graph. An agent "
    "chose the object that its gripper was nearest to at the end. Choice and reach are "
    "reported apart: an arm that chooses well may grasp badly, and the reverse.",
    "Corrected for chance, 0 is an agent that chooses at random and 1 one that is always right; "
    "for success, at random means that it reaches the objects it chooses as often as now.",
    "An agent understood the queries of a split if it chose better than chance and than every "
    "control that ran (Welch's t over training seeds, Holm's correction over all agents and splits "
    f"of the report, adjusted p of at most {ALPHA}, at least {FEWEST_SEEDS} seeds of each agent). "
    "On S1 a code without meaning is enough; S2 to S5 require the meaning. Of other questions, "
    "values or objects than those drawn it is shown if intervals over these and training seeds lie "
    "above every control, too.",
)

BEYOND_CHANCE = percent_axis("corrected for chance", whole=False)
MEASURES = (
    "choice",
    "choice_corrected",
    "success",
    "success_if_chosen",
    "success_corrected",
    "binding",
    "chose_old_answer",
    "switched",
)
TABLES = {
    "choice": "choice",
    "reach": "success",
    "binding": "binding",
    "switched": "switched",
}
"""Tables of agents that have a measure, which is drawn where it can be corrected for chance."""


def query_blocks(task: TaskData, findings: Sequence[Finding]) -> list[Block]:
    """Show choice and reach by split, how they were learned, and the kinds of queries."""
    if not task.splits:
        return []
    agents = list(chain.from_iterable(task.splits.values()))
    blocks: list[Block] = [
        finding.verdict() for finding in findings if finding.task is task
    ]
    rows = [_row(agent, *MEASURES) for agent in agents]
    for name, key in TABLES.items():
        known = [row for row in rows if row[key]]
        if known:
            table = table_of(task, name, known)
            blocks.append(_figure(table, f"{key}_corrected"))
    if any("choice" in run.interim for run in task.runs):
        measures = {"choice": CHOICE_AXIS}
        title = "Learning to choose"
        blocks.append(curve_figure(task, measures, "choice-curves", title))
    return [*blocks, _by_type(task, agents)]


def _row(agent: Group, *keys: str) -> Row:
    row = row_of(agent, *keys) | {"split": agent.split, "chance": agent.chance}
    return row | {"_panel": _split_title(agent)}


def _split_title(agent: Group) -> str:
    return f"{agent.split}: {SPLITS[agent.split]}"


def _figure(table: DataTable, key: str) -> Block:
    """Draw a column of a table, one drawing per split; the table alone if it has no such column."""
    if key not in table.csv_columns():
        return table
    panels = dot_panels(table, key, BEYOND_CHANCE, seeds=True, zero=True)
    return Figure(table, panels, open_table=True)


def _by_type(task: TaskData, agents: Sequence[Group]) -> Figure:
    """Show the choice by the relations that a query names; draw it for the first split."""
    first = next(iter(task.splits))
    rows = []
    for agent in agents:
        kinds: set[str] = set()
        for evaluation in agent.evaluations:
            kinds |= evaluation.summary.groups["query_type"].keys()
        for kind in sorted(kinds):
            row = row_of(agent) | {"split": agent.split, "type": kind}
            for key in ("choice", "success"):
                row[key] = agent.level(key, "query_type", kind)
            if agent.split == first:
                row["_panel"] = facet(kind)
            rows.append(row)
    table = table_of(task, "query-types", rows, split=first)
    return Figure(table, dot_panels(table, "choice", CHOICE_AXIS, width=340))
