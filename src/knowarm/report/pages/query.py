"""Page "Query": which object each agent chose, by split, by kind of query and by object."""

from collections.abc import Mapping, Sequence

import numpy as np
import scipy

from knowarm.errors import UserError
from knowarm.knowledge.queries.splits import SPLITS
from knowarm.report import format
from knowarm.report.blocks import (
    Block,
    Column,
    DataTable,
    Figure,
    Panel,
    Row,
    Verdict,
    column_of,
    files,
    row_of,
    shared,
    table_of,
)
from knowarm.report.charts import CHOICE_AXIS, percent_axis
from knowarm.report.collect import split_groups
from knowarm.report.diagrams import confusion_map, dot_chart, group_dot
from knowarm.report.model import Group, SplitGroup, TaskData
from knowarm.report.pages.results import part_panels
from knowarm.report.pages.training import curve_figure
from knowarm.report.verdicts.claims import ALPHA, FEWEST_SEEDS, Finding
from knowarm.statistics import Interval

EXPLANATION = (
    "Several objects are visible, and a query describes one of them by facts of a graph. An agent "
    "chose the object that its gripper was nearest to at the end. Choice and reach are "
    "reported apart: an arm that chooses well may grasp badly, and the reverse.",
    "Corrected for chance, 0 is an agent that chooses at random and 1 one that is always right; "
    "for success, at random means that it reaches the objects it chooses as often as now.",
    "An agent understood the queries of a split if it chose better than chance and than every "
    "control that ran (Welch's t over training seeds, Holm's correction over all agents and splits "
    f"of the report, adjusted p of at most {ALPHA}, at least {FEWEST_SEEDS} seeds of each agent). "
    "On S1 a code without meaning is enough; S2 to S5 require the meaning.",
)

Splits = Mapping[str, Sequence[SplitGroup]]
Columns = Sequence[Column]

BEYOND_CHANCE = percent_axis("corrected for chance", whole=False)

CHOICE_COLUMNS = (
    Column("chance", "chance", "percent"),
    *shared("choice", "choice_corrected"),
)
REACH_COLUMNS = (*shared("success", "success_if_chosen", "success_corrected"),)
SWITCH_COLUMNS = (
    column_of("choice", "new answer"),
    *shared("chose_old_answer", "switched"),
)
BINDING_NOTE = (
    "Follows its question: right choices, minus those when the agent is told the question of "
    "another visible object. 100 points: it always goes where it is told; 0: the question changes "
    "nothing."
)
SWITCH_NOTE = (
    "Shares of episodes that ended at the object that the query means in the edited graph "
    "(new), or at one that it meant before (old). Switched: new among both. The old answer is "
    "not visible in every episode, so compare with the controls rather than with one half."
)


def query_blocks(task: TaskData, findings: Sequence[Finding]) -> list[Block]:
    """Show choice and reach by split, how they were learned, and what was confused."""
    splits = split_groups(task)
    if not splits:
        return []
    blocks: list[Block] = [each.verdict() for each in findings if each.task is task]
    blocks += [
        _measure(task, splits, "choice", "Choice", CHOICE_COLUMNS),
        _measure(task, splits, "success", "Reach", REACH_COLUMNS),
    ]
    bound = [each for each in _all(splits) if each.level("binding")]
    if bound:
        title = "Does the arm follow its question?"
        columns = shared("choice", "binding")
        blocks.append(_table(task, "binding", title, columns, bound, BINDING_NOTE))
    edited = [each for each in _all(splits) if each.level("switched")]
    if edited:
        title = "Does the arm follow the edited graph?"
        blocks.append(_table(task, "switched", title, SWITCH_COLUMNS, edited, SWITCH_NOTE))
    if any("choice" in run.interim for run in task.runs):
        measures = {"choice": CHOICE_AXIS}
        blocks.append(curve_figure(task, measures, "choice-curves", "Learning to choose"))
    return [*blocks, _by_type(task, splits), *_confusion(task, splits)]


def _all(splits: Splits) -> list[SplitGroup]:
    return [each for asked in splits.values() for each in asked]


def _table(
    task: TaskData, name: str, title: str, columns: Columns, asked: Sequence[SplitGroup], note: str
) -> DataTable:
    keys = [column.key for column in columns if column.interval]
    shown = shared("split", "agent", "seeds", *columns)
    rows = [{"split": g.split, "chance": g.chance} | row_of(task, g, *keys) for g in asked]
    return table_of(task, name, title, shown, rows, files(asked), note)


def _measure(task: TaskData, splits: Splits, key: str, title: str, columns: Columns) -> Figure:
    """Draw one number of every agent, corrected for chance, one drawing per split."""
    panels = []
    for split, asked in splits.items():
        dots = [group_dot(each, f"{key}_corrected", task.colours) for each in asked]
        words = f"{title} on {split}, corrected for chance: {task.title}"
        svg = dot_chart(dots, words, BEYOND_CHANCE, zero=True, left=150)
        panels.append(Panel(svg=svg, title=f"{split}: {SPLITS[split]}"))
    note = (
        "95 % intervals: over five or more training seeds (bootstrap of the mean), "
        "over episodes where there is one."
    )
    caption = (
        "Line at 0: a choice at random. Dot: mean over training seeds; line: 95 % interval "
        "over seeds. Small dots: single seeds."
    )
    table = _table(task, title.lower(), f"{title} by split", columns, _all(splits), note)
    return Figure(table=table, caption=caption, panels=panels, open_table=True)


def _by_type(task: TaskData, splits: Splits) -> Figure:
    """Show the choice by the relations that a query names."""
    rows: list[Row] = []
    for agent in _all(splits):
        for kind in _types([agent]):
            row = {"split": agent.split, "type": kind} | row_of(task, agent)
            levels = {k: agent.level(k, "query_type", kind) for k in ("choice", "success")}
            rows.append(row | levels)
    first, asked = next(iter(splits.items()))
    by_name = {each.name: each for each in asked}

    def choice(group: Group, name: str) -> Interval | None:
        return by_name[group.name].level("choice", "query_type", name)

    groups = [each.group for each in asked]
    panels = part_panels(task, _types(asked), groups, choice, CHOICE_AXIS)[1]
    asked_as = Column("type", "kind of query")
    columns = shared("split", asked_as, "agent", "choice", "success")
    title, sources = f"Right choices by kind of query, {first}", files(_all(splits))
    table = table_of(task, "query-types", title, columns, rows, sources)
    caption = (
        "Kind: the relations that the query names. Dot: mean over training seeds; line: "
        "95 % interval. The table has all splits."
    )
    return Figure(table=table, caption=caption, panels=panels)


def _types(asked: Sequence[SplitGroup]) -> list[str]:
    summaries = [evaluation.summary for each in asked for evaluation in each.evaluations]
    return sorted({kind for each in summaries for kind in each.groups["query_type"]})


def _confusion(task: TaskData, splits: Splits) -> list[Block]:
    """Show which object was chosen for which, by the first agent that receives the query."""
    first = [each for each in _all(splits) if each.group.role == "knowledge"] or _all(splits)
    agents = [each for each in _all(splits) if each.group is first[0].group]
    rows: list[Row] = []
    panels = []
    try:
        for agent in agents:
            asked, chosen, counts = _counts(agent)
            totals = counts.sum(axis=1, keepdims=True)
            shares = counts / totals
            words = f"Objects chosen by {agent.name} on {agent.split}: {task.title}"
            wanted, found = ([format.facet(name) for name in kind] for kind in (asked, chosen))
            svg = confusion_map(shares, wanted, found, words)
            panels.append(Panel(svg=svg, title=f"{agent.split}: {SPLITS[agent.split]}"))
            for i, j in np.argwhere(counts):
                row = {"split": agent.split, "asked": asked[i], "chosen": chosen[j]}
                rows.append(row | {"episodes": int(counts[i, j]), "share": float(shares[i, j])})
    except UserError as error:
        return [Verdict(sentence=str(error), tone="bad")]
    columns: list[str | Column] = [
        *("split", Column("asked", "wanted object"), Column("chosen", "chosen object")),
        *("episodes", Column("share", "share of the wanted", "percent")),
    ]
    title = f"Chosen against wanted object, {agents[0].name}"
    sources = files(agents, "episodes.parquet")
    table = table_of(task, "confusion", title, columns, rows, sources)
    caption = (
        "Row: the wanted object. Column: the chosen one. The darker a cell, the larger its share "
        "of the row's episodes, over all training seeds."
    )
    return [Figure(table=table, caption=caption, panels=panels)]


def _counts(asked: SplitGroup) -> tuple[list[str], list[str], np.ndarray]:
    """Count the episodes of every wanted and chosen object: names, names, (R, C) int64."""
    tables = [evaluation.episodes("chosen") for evaluation in asked.evaluations]
    names = [[str(name) for t in tables for name in t[key]] for key in ("target", "chosen")]
    (rows, columns), counts = scipy.stats.contingency.crosstab(*names)
    return rows.tolist(), columns.tolist(), counts
