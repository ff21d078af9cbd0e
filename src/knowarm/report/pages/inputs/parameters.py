"""Runs of one task go in; how many parameters each part of their networks has comes out."""

from collections.abc import Sequence
from pathlib import Path

from knowarm.report.blocks import Block, Column, Figure, Panel, Table
from knowarm.report.figures import stacked_bars
from knowarm.report.study import Run, Task


def parameters(task: Task, shown: Sequence[tuple[str, Run]]) -> list[Block]:
    """Stacked bars of trainable parameters; nothing where no run stored its counts."""
    counts = {}
    sources: list[Path] = []
    for name, run in shown:
        known = run.provenance.get("parameter_counts") or {}
        parts = {k: int(v) for k, v in known.items() if k != "total" and v}
        if parts:
            counts[name] = parts
            sources.append(run.path / "provenance.json")
    if not counts:
        return []
    rows = [
        {"agent": name, "part": part, "parameters": count}
        for name, parts in counts.items()
        for part, count in parts.items()
    ]
    figure = Figure(
        title=f"Trainable parameters: {task.title}",
        caption="A longer vector makes a larger LSTM: compare agents of equal size.",
        panels=[Panel(svg=stacked_bars(counts, "Trainable parameters by part of the network"))],
        legend=[
            (part, f"s{i % 8}")
            for i, part in enumerate(dict.fromkeys(p for each in counts.values() for p in each))
        ],
        table=Table(
            name=f"parameters-{task.name}",
            title="Trainable parameters",
            columns=[
                Column(key="agent", label="agent"),
                Column(key="part", label="part"),
                Column(key="parameters", label="parameters", format="integer"),
            ],
            rows=rows,
            sources=sources,
        ),
    )
    return [figure]
