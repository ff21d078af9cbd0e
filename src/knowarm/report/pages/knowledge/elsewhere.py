"""Evaluations under other labels go in; how the agents compare there comes out."""

import numpy as np

from knowarm.report.blocks import Block, Column, Row, Table
from knowarm.report.levels import cells
from knowarm.report.palette import colours
from knowarm.report.study import Group, Judged, Task
from knowarm.statistics import welch


def elsewhere(task: Task, asked: Group) -> list[Block]:
    """Evaluations under other labels, such as held-out colours or sampled actions."""
    by_label: dict[str, dict[str, list[Judged]]] = {}
    for group in task.groups:
        for run in group.runs:
            for label, judged in run.judged.items():
                if label != task.label and not label.endswith(("-untrained", "-latest")):
                    by_label.setdefault(label, {}).setdefault(group.name, []).append(judged)
    rows: list[Row] = []
    chosen = colours(group.name for group in task.groups)
    for label, groups in sorted(by_label.items()):
        base = [each.summary["success"] for each in groups.get(asked.name, [])]
        for name, many in groups.items():
            values = [each.summary["success"] for each in many]
            row: Row = {
                "label": label,
                "agent": name,
                "seeds": len(values),
                "success": sum(values) / len(values),
                "_colour": chosen[name],
            }
            if name != asked.name and min(len(base), len(values)) > 1:
                row |= cells("difference", welch(np.array(base), np.array(values)).difference)
            rows.append(row)
    if not rows:
        return []
    return [
        Table(
            name=f"elsewhere-{task.name}",
            title=f"Under other conditions: {task.title}",
            columns=[
                Column(key="label", label="evaluation"),
                Column(key="agent", label="agent"),
                Column(key="seeds", label="seeds", format="integer"),
                Column(key="success", label="success", format="percent"),
                Column(
                    key="difference",
                    label=f"{asked.name} minus it [points]",
                    format="points",
                    interval=True,
                ),
            ],
            rows=rows,
            sources=[
                j.folder for groups in by_label.values() for many in groups.values() for j in many
            ],
            note="Evaluations kept under another label: held-out colours, other thresholds, "
            "sampled actions. 95 % intervals over training seeds, not corrected.",
        )
    ]
