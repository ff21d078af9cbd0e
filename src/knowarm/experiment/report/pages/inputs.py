"""Runs go in; the page that shows what the networks were given comes out."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from knowarm.config import from_dict
from knowarm.errors import UserError
from knowarm.experiment.report.blocks import (
    Block,
    Column,
    Figure,
    Page,
    Pair,
    Panel,
    Row,
    Table,
    Verdict,
)
from knowarm.experiment.report.figures import graph_drawing, heat_strip, stacked_bars
from knowarm.experiment.report.slug import slugs
from knowarm.experiment.report.study import Run, Study, Task
from knowarm.experiment.run_folder import RunFolder
from knowarm.knowledge import KnowledgeConfig, scene_subgraph

MOST_PICTURES = 4
"""Different knowledge vectors that are drawn; all stand in the table."""


DRAWN_FIRST = ("full", "full+", "partial", "target")


def inputs_page(study: Study) -> Page:
    """The graph, the sentences, the vector, and how many parameters see it."""
    page = Page(
        name="inputs",
        short="Inputs",
        title="What went in",
        lead="The picture is the same for all agents; they differ in what else they are told.",
    )
    for task in study.tasks:
        page.add(task, _task_blocks(task))
    return page


def _task_blocks(task: Task) -> list[Block]:
    shown = [(group.name, group.runs[0]) for group in task.groups if group.runs]
    blocks: list[Block] = [_constants(task, shown), _table(task, shown)]
    stems = slugs(group.name for group in task.groups)
    drawn: set[str] = set()
    graphs: set[str] = set()
    for name, run in sorted(shown, key=lambda each: _rank(each[1].agent)):
        known = _known(run)
        key = json.dumps(known.get("config", known), sort_keys=True)
        if not known.get("slots") or key in drawn or len(drawn) >= MOST_PICTURES:
            continue
        drawn.add(key)
        blocks += _knowledge(name, f"{task.name}-{stems[name]}", run, known, graphs)
    parameters = _parameters(task, shown)
    return [*blocks, parameters] if parameters else blocks


def _rank(agent: str) -> int:
    """Agents with knowledge come before controls, whose vectors copy theirs."""
    return DRAWN_FIRST.index(agent) if agent in DRAWN_FIRST else len(DRAWN_FIRST)


def _constants(task: Task, shown: Sequence[tuple[str, Run]]) -> Verdict:
    constant = [name for name, run in shown if _known(run).get("constant")]
    privileged = [name for name, run in shown if _known(run).get("privileged")]
    reasons = []
    if constant:
        reasons.append(
            f"{', '.join(constant)}: every episode gets the same numbers. To the network such an "
            "input is a bias with its own learning rate and extra capacity; it cannot tell one "
            "episode from another. Compare with zeros and wide."
        )
    if privileged:
        reasons.append(
            f"{', '.join(privileged)}: the numbers name the object of the episode, which no camera "
            "told the agent. Compare with a one-hot of the same facts."
        )
    if not reasons:
        return Verdict(sentence=f"{task.title}: no agent was given a knowledge vector.")
    if constant and not privileged:
        sentence = f"{task.title}: the knowledge is a constant input, which is a bias."
    else:
        sentence = f"{task.title}: what kind of input the knowledge is."
    return Verdict(sentence=sentence, reasons=reasons, tone="open")


def _known(run: Run) -> Mapping[str, Any]:
    """What the run was told; nothing where the network was given no number of it (wide)."""
    try:
        given = RunFolder(run.path).knowledge().size > 0
    except UserError:
        given = True
    return (run.provenance.get("knowledge") or {}) if given else {}


def _table(task: Task, shown: Sequence[tuple[str, Run]]) -> Table:
    rows: list[Row] = []
    for name, run in shown:
        known = _known(run)
        coverage = known.get("coverage")
        share = coverage.get("share") if isinstance(coverage, Mapping) else coverage
        rows.append(
            {
                "agent": name,
                "source": (known.get("config") or {}).get("source") if known.get("slots") else None,
                "slots": len(known.get("slots") or []),
                "numbers": known.get("dim", 0) or 0,
                "norm": known.get("norm"),
                "coverage": share if known.get("slots") else None,
                "constant": bool(known.get("constant")),
                "privileged": bool(known.get("privileged")),
                "note": known.get("note") or "",
            }
        )
    return Table(
        name=f"knowledge-{task.name}",
        title=f"Knowledge vectors: {task.title}",
        columns=[
            Column(key="agent", label="agent"),
            Column(key="source", label="vectors from"),
            Column(key="slots", label="slots", format="integer"),
            Column(key="numbers", label="numbers", format="integer"),
            Column(key="norm", label="norm", format="number"),
            Column(key="coverage", label="words known", format="percent"),
            Column(key="constant", label="constant"),
            Column(key="privileged", label="privileged"),
            Column(key="note", label="note"),
        ],
        rows=rows,
        sources=[run.path / "provenance.json" for _, run in shown],
    )


def _knowledge(
    name: str, stem: str, run: Run, known: Mapping[str, Any], graphs: set[str]
) -> list[Block]:
    blocks: list[Block] = []
    left: list[Block] = []
    right: list[Block] = []
    try:
        triples = _triples(run, known)
    except (UserError, OSError, KeyError, TypeError, ValueError) as error:
        triples = []
        blocks.append(
            Verdict(sentence=f"The graph of {name} cannot be drawn again: {error}", tone="note")
        )
    words = json.dumps(triples)
    if triples and words not in graphs:
        graphs.add(words)
        left.append(_graph(name, stem, triples, run))
    matrix = _matrix(run, known)
    if matrix is not None:
        right.append(_vector(name, stem, run, known, matrix))
    sentences = known.get("sentences") or {}
    if any(sentences.values()):
        rows = [{"slot": slot, "sentence": sentence} for slot, sentence in sentences.items()]
        right.append(
            Table(
                name=f"sentences-{stem}",
                title=f"The sentence of each slot: {name}",
                columns=[
                    Column(key="slot", label="slot"),
                    Column(key="sentence", label="sentence"),
                ],
                rows=rows,
                sources=[run.path / "provenance.json"],
            )
        )
    return [
        *blocks,
        Pair(left=left, right=right) if left else Pair(left=right[:1], right=right[1:]),
    ]


def _triples(run: Run, known: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    facets = known.get("facets") or run.provenance.get("facets")
    if not facets or known.get("config", {}).get("detail") == "none":
        return []
    config = from_dict(KnowledgeConfig, known["config"], where="knowledge")
    return list(scene_subgraph(config, [(str(a), str(b)) for a, b in facets]))


def _graph(name: str, stem: str, triples: list[tuple[str, str, str]], run: Run) -> Figure:
    words = [tuple(part.replace("_", " ") for part in triple) for triple in triples]
    title = f"What the graph says about the objects: {len(triples)} facts"
    svg = graph_drawing([(a, b, c) for a, b, c in words], title)
    rows = [{"head": a, "relation": b, "tail": c} for a, b, c in triples]
    return Figure(
        title=f"The subgraph of the perceived objects: {name}",
        caption="Left: the objects. Right: what is said about them, by relation. A fact that two "
        "objects share has two lines.",
        panels=[Panel(svg=svg)],
        table=Table(
            name=f"graph-{stem}",
            title="Facts",
            columns=[Column(key=key, label=key) for key in ("head", "relation", "tail")],
            rows=rows,
            sources=[run.path / "config.json"],
        ),
    )


def _matrix(run: Run, known: Mapping[str, Any]) -> np.ndarray | None:
    """The vector as (slots, numbers): a row of the stored table cut in slots, or its rows."""
    try:
        table = RunFolder(run.path).knowledge()
    except UserError:
        return None
    slots = len(known["slots"])
    if table.size == 0 or table.ndim != 2:
        return None
    if known.get("constant") or len(table) == 1 or np.ptp(table, axis=0).max() == 0:
        return table[0].reshape(slots, -1) if table.shape[1] % slots == 0 else table[:1]
    return np.unique(table, axis=0) if len(table) != slots else table


def _vector(name: str, stem: str, run: Run, known: Mapping[str, Any], matrix: np.ndarray) -> Figure:
    names = [str(slot) for slot in known["slots"]]
    if len(names) != len(matrix):
        names = [f"row {i + 1}" for i in range(len(matrix))]
    norm = float(np.linalg.norm(matrix.astype(np.float64)))
    shape = f"{matrix.size} numbers, {len(matrix)} slots of {matrix.shape[1]}, norm {norm:.2f}"
    rows = [
        {"slot": slot, "index": i, "value": float(value)}
        for slot, vector in zip(names, matrix, strict=True)
        for i, value in enumerate(vector)
    ]
    return Figure(
        title=f"The vector: {name}",
        caption=f"{shape}. Orange above zero, blue below, pale near zero.",
        panels=[Panel(svg=heat_strip(matrix, names, f"The knowledge vector of {name}: {shape}"))],
        table=Table(
            name=f"vector-{stem}",
            title="Every number of the vector",
            columns=[
                Column(key="slot", label="slot"),
                Column(key="index", label="index", format="integer"),
                Column(key="value", label="value", format="number3"),
            ],
            rows=rows,
            sources=[run.path / "knowledge.safetensors"],
        ),
    )


def _parameters(task: Task, shown: Sequence[tuple[str, Run]]) -> Figure | None:
    counts = {}
    sources: list[Path] = []
    for name, run in shown:
        known = run.provenance.get("parameter_counts") or {}
        parts = {k: int(v) for k, v in known.items() if k != "total" and v}
        if parts:
            counts[name] = parts
            sources.append(run.path / "provenance.json")
    if not counts:
        return None
    rows = [
        {"agent": name, "part": part, "parameters": count}
        for name, parts in counts.items()
        for part, count in parts.items()
    ]
    return Figure(
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
