"""A run goes in; its graph, its sentences and its vector, to be looked at, come out."""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from knowarm.config import from_dict
from knowarm.errors import UserError
from knowarm.experiment.run_folder import RunFolder
from knowarm.knowledge import KnowledgeConfig, migrate_source, scene_subgraph
from knowarm.report.blocks import Block, Column, Figure, Pair, Panel, Table, Verdict
from knowarm.report.figures import graph_drawing, heat_strip
from knowarm.report.study import Run


def knowledge(
    name: str, stem: str, run: Run, known: Mapping[str, Any], graphs: set[str]
) -> list[Block]:
    """Draw one agent's knowledge; ``graphs`` holds the graphs that were drawn before."""
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
    config = from_dict(KnowledgeConfig, migrate_source(known["config"]), where="knowledge")
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
