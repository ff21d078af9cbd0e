"""Page "Query": which object each agent chose, by split, by kind of query and by object."""

from collections.abc import Mapping, Sequence

import numpy as np

from knowarm.errors import UserError
from knowarm.knowledge.query_splits import SPLITS
from knowarm.report import format
from knowarm.report.blocks import (
    Block,
    Column,
    Figure,
    Panel,
    Row,
    Table,
    Verdict,
    cells,
    shared,
)
from knowarm.report.charts import CHOICE_AXIS, Axis
from knowarm.report.choice import Asked, Finding, asked_splits
from knowarm.report.claims import ALPHA, FEWEST_SEEDS
from knowarm.report.diagrams import confusion_map, dot_chart, group_dot
from knowarm.report.pages.results import part_panels
from knowarm.report.pages.training import curve_figure
from knowarm.report.study import Evaluation, Group, Task
from knowarm.statistics import Interval

EXPLANATION = (
    "Several objects are visible, and the episode asks for one of them by what a graph knows. An "
    "agent chose the object that its gripper was nearest to at the end. Choice and reach are "
    "reported apart: an arm that chooses well may grasp badly, and the reverse.",
    "Corrected for chance, 0 is an agent that chooses at random and 1 one that is always right; "
    "for success, at random means that it reaches the objects it chooses as often as now.",
    "An agent understood the questions of a split if it chose better than chance and than every "
    "control that ran (Welch's t over training seeds, Holm's correction over all agents and splits "
    f"of the report, adjusted p of at most {ALPHA}, at least {FEWEST_SEEDS} seeds of each agent). "
    "On S1 a code without meaning is enough; S2 to S5 ask what only the meaning answers.",
)

BEYOND_CHANCE = Axis(title="corrected for chance", format=format.whole_percent)

CHOICE_COLUMNS = (
    Column("chance", "chance", "percent"),
    *shared("choice"),
    Column("choice_corrected", "corrected for chance", "percent", interval=True),
)
REACH_COLUMNS = (
    *shared("success"),
    Column("success_if_chosen", "success if chosen rightly", "percent", interval=True),
    Column("success_corrected", "corrected for chance", "percent", interval=True),
)
SWITCH_COLUMNS = (
    Column("choice", "new answer", "percent", interval=True),
    Column("chose_old_answer", "old answer", "percent", interval=True),
    Column("switched", "switched", "percent", interval=True, hint="new of new and old"),
)


def query_blocks(task: Task, findings: Sequence[Finding]) -> list[Block]:
    """Show choice and reach by split, how they were learned, and what was confused."""
    splits = asked_splits(task)
    if not splits:
        return []
    blocks: list[Block] = [each.verdict() for each in findings if each.task is task]
    blocks += [
        _measure(task, splits, "choice", "Choice", CHOICE_COLUMNS),
        _measure(task, splits, "success", "Reach", REACH_COLUMNS),
    ]
    edited = [each for each in _all(splits) if each.level("switched")]
    if edited:
        blocks.append(_switching(task, edited))
    if any("choice" in run.interim for run in task.runs):
        measures = {"choice": CHOICE_AXIS}
        blocks.append(curve_figure(task, measures, "choice-curves", "Learning to choose"))
    return [*blocks, _by_type(task, splits), *_confusion(task, splits)]


def _all(splits: Mapping[str, Sequence[Asked]]) -> list[Asked]:
    return [each for asked in splits.values() for each in asked]


def _folders(asked: Sequence[Asked]) -> list[Evaluation]:
    return [evaluation for each in asked for evaluation in each.evaluations]


def _rows(task: Task, asked: Sequence[Asked], columns: Sequence[Column]) -> list[Row]:
    rows = []
    for each in asked:
        row: Row = {"split": each.split, "agent": each.name, "seeds": len(each.evaluations)}
        row |= {"chance": each.chance, "_colour": task.colours[each.name]}
        for column in columns:
            if column.interval:
                row |= cells(column.key, each.level(column.key))
        rows.append(row)
    return rows


def _measure(
    task: Task,
    splits: Mapping[str, Sequence[Asked]],
    key: str,
    title: str,
    columns: Sequence[Column],
) -> Figure:
    """Draw one number of every agent, corrected for chance, one drawing per split."""
    panels = []
    for split, asked in splits.items():
        dots = [group_dot(each, f"{key}_corrected", task.colours) for each in asked]
        words = f"{title} on {split}, corrected for chance: {task.title}"
        svg = dot_chart(dots, words, BEYOND_CHANCE, zero=True, left=150)
        panels.append(Panel(svg=svg, title=f"{split}: {SPLITS[split]}"))
    return Figure(
        title=f"{title} by split: {task.title}",
        caption="Line at 0: a choice at random. Dot: mean over training seeds; line: 95 % interval "
        "over seeds. Small dots: single seeds.",
        panels=panels,
        table=Table(
            name=f"{title.lower()}-{task.name}",
            title=f"{title} by split",
            columns=[*shared("split", "agent", "seeds"), *columns],
            rows=_rows(task, _all(splits), columns),
            sources=[each.folder / "summary.json" for each in _folders(_all(splits))],
            note="95 % intervals: over training seeds where there are several (bootstrap of the "
            "mean), over episodes where there is one.",
        ),
        open_table=True,
    )


def _switching(task: Task, asked: Sequence[Asked]) -> Table:
    return Table(
        name=f"switched-{task.name}",
        title=f"Does the arm follow the edited graph? {task.title}",
        columns=[*shared("split", "agent", "seeds"), *SWITCH_COLUMNS],
        rows=_rows(task, asked, SWITCH_COLUMNS),
        sources=[each.folder / "summary.json" for each in _folders(asked)],
        note="Shares of episodes that ended at the object that the query means in the edited graph "
        "(new), or at one that it meant before (old). Switched: new among both. The old answer is "
        "not visible in every episode, so compare with the controls rather than with one half.",
    )


def _by_type(task: Task, splits: Mapping[str, Sequence[Asked]]) -> Figure:
    """Show the choice by the relations that a query names."""
    rows: list[Row] = []
    for each in _all(splits):
        for kind in _types([each]):
            row: Row = {"split": each.split, "type": kind, "agent": each.name}
            row |= cells("choice", each.level("choice", "per_type", kind))
            row |= cells("success", each.level("success", "per_type", kind))
            rows.append(row | {"_colour": task.colours[each.name]})
    first, asked = next(iter(splits.items()))
    by_name = {each.name: each for each in asked}

    def choice(group: Group, name: str) -> Interval | None:
        return by_name[group.name].level("choice", "per_type", name)

    groups = [each.group for each in asked]
    _, panels = part_panels(task, _types(asked), groups, choice, CHOICE_AXIS)
    return Figure(
        title=f"Right choices by kind of query, {first}: {task.title}",
        caption="Kind: the relations that the query names. Dot: mean over training seeds; line: "
        "95 % interval. The table has all splits.",
        panels=panels,
        table=Table(
            name=f"query-types-{task.name}",
            title="Choice and success by kind of query",
            columns=[
                *shared("split"),
                Column("type", "kind of query"),
                *shared("agent", "choice", "success"),
            ],
            rows=rows,
            sources=[each.folder / "summary.json" for each in _folders(_all(splits))],
        ),
    )


def _types(asked: Sequence[Asked]) -> list[str]:
    return sorted({kind for each in _folders(asked) for kind in each.summary["per_type"]})


def _confusion(task: Task, splits: Mapping[str, Sequence[Asked]]) -> list[Block]:
    """Show which object was chosen for which, by the first agent that is told the query."""
    told = [each for each in _all(splits) if each.group.role == "knowledge"] or _all(splits)
    shown = [each for each in _all(splits) if each.group is told[0].group]
    rows: list[Row] = []
    panels = []
    try:
        for each in shown:
            asked, chosen, counts = _counts(each)
            totals = counts.sum(axis=1, keepdims=True)
            words = f"Objects chosen by {each.name} on {each.split}: {task.title}"
            wanted, found = ([format.facet(name) for name in kind] for kind in (asked, chosen))
            svg = confusion_map(counts / totals, wanted, found, words)
            panels.append(Panel(svg=svg, title=f"{each.split}: {SPLITS[each.split]}"))
            rows += [
                {
                    "split": each.split,
                    "asked": asked[i],
                    "chosen": chosen[j],
                    "episodes": int(counts[i, j]),
                    "share": float(counts[i, j] / totals[i, 0]),
                }
                for i, j in np.argwhere(counts)
            ]
    except UserError as error:
        return [Verdict(sentence=str(error), tone="bad")]
    return [
        Figure(
            title=f"Chosen against asked, {shown[0].name}: {task.title}",
            caption="Row: the wanted object. Column: the chosen one. The darker a cell, the larger "
            "its share of the row's episodes, over all training seeds.",
            panels=panels,
            table=Table(
                name=f"confusion-{task.name}",
                title=f"Objects chosen by {shown[0].name}",
                columns=[
                    *shared("split"),
                    Column("asked", "wanted object"),
                    Column("chosen", "chosen object"),
                    Column("episodes", "episodes", "integer"),
                    Column("share", "share of the wanted", "percent"),
                ],
                rows=rows,
                sources=[each.folder / "episodes.parquet" for each in _folders(shown)],
            ),
        )
    ]


def _counts(asked: Asked) -> tuple[list[str], list[str], np.ndarray]:
    """Count the episodes of every wanted and chosen object: names, names, (R, C) int64."""
    tables = [evaluation.episodes() for evaluation in asked.evaluations]
    pairs = [
        (str(wanted), str(chosen))
        for table in tables
        for wanted, chosen in zip(table["target"], table["chosen"], strict=True)
    ]
    rows, columns = (sorted({pair[i] for pair in pairs}) for i in (0, 1))
    counts = np.zeros((len(rows), len(columns)), np.int64)
    for wanted, chosen in pairs:
        counts[rows.index(wanted), columns.index(chosen)] += 1
    return rows, columns, counts
