"""Page "Inputs": the knowledge graph, sentences and vector of each agent, and network sizes."""

import json
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import numpy as np

from knowarm.config import from_dict
from knowarm.errors import UserError
from knowarm.experiment.run_folder import RunFolder
from knowarm.knowledge import KnowledgeConfig, scene_subgraph
from knowarm.learn.algorithms import privileged_uses
from knowarm.report.blocks import (
    Block,
    Column,
    DataTable,
    Figure,
    Pair,
    Panel,
    Row,
    Tone,
    Verdict,
    shared,
    table_of,
)
from knowarm.report.diagrams import SHADES, graph_diagram, heat_map, stacked_bars
from knowarm.report.format import listed, slugs
from knowarm.report.model import CONTROLS, Group, RunData, TaskData

MOST_VECTORS = 4  # distinct knowledge vectors that are drawn; the table lists all
MOST_SLOTS = 24  # slots of a vector that the page shows; the run folder has all of them

KINDS = (
    (
        "every episode has the same vector. For the network such an input is a bias with its own "
        "learning rate and additional capacity; it cannot tell episodes apart.",
        *("the knowledge vector is a constant input, which is a bias", "capacity_control", "scene"),
    ),
    (
        "the vector describes what a perception module names in the first image of the episode.",
        *("the knowledge vector describes what is perceived", "content_control", "perceived"),
    ),
    (
        "the vector describes the query of the episode.",
        *("the knowledge vector describes the query of the episode", "content_control", "query"),
    ),
    (
        "the vector identifies the target of the episode, which no camera observed.",
        *("some knowledge vectors are privileged", "content_control", "target"),
    ),
)
"""Kinds of vectors: of some agents, of the task, and role and scope of the controls. The last kind
that a task has describes it."""

VECTOR_COLUMNS = (Column("index", "index", "integer"), Column("value", "value", "number3"))

PRIVILEGED_TRAINING = (
    "{agents}: training used the simulator's state. The policy receives the image alone, in "
    "training and in every evaluation."
)


def input_blocks(task: TaskData) -> list[Block]:
    """Show the graph, the sentences, the vector, and how many parameters receive it."""
    blocks: list[Block] = [_kind_of_input(task), _overview(task)]
    stems = slugs(group.name for group in task.groups)
    drawn, graphs = set[str](), set[str]()
    # Controls last: their vectors are derived from those of the other agents.
    for group in sorted(task.groups, key=lambda g: (g.role in CONTROLS, g not in task.subjects)):
        known = _known(group.runs[0])
        key = json.dumps(known.get("config", known), sort_keys=True)
        if known.get("slots") and key not in drawn and len(drawn) < MOST_VECTORS:
            drawn.add(key)
            blocks += _knowledge(group, f"{task.name}-{stems[group.name]}", known, graphs)
    return [*blocks, *_parameters(task)]


def _known(run: RunData) -> Mapping[str, Any]:
    """Return the description of a run's knowledge vector; empty if the network received none."""
    table = _table(run)
    no_input = table is not None and table.size == 0
    return {} if no_input else run.provenance.get("knowledge") or {}


def _table(run: RunData) -> np.ndarray | None:
    """Read the knowledge table (F, K) of a run; None if it cannot be read."""
    with suppress(UserError):
        return RunFolder(run.path).knowledge()
    return None


def _kind_of_input(task: TaskData) -> Verdict:
    """State which agents have a constant vector and which a privileged one."""
    known = {group.name: _known(group.runs[0]) for group in task.groups}
    sentence, reasons = "no agent received a knowledge vector", []
    for words, said, role, scope in KINDS:
        if scope in ("query", "perceived"):
            agents = [g.name for g in task.groups if g.scope == scope and known[g.name]]
        else:
            flag = "constant" if scope == "scene" else "privileged"
            agents = [name for name, each in known.items() if each.get(flag)]
        if agents:
            ran = [g.name for g in task.groups if g.role == role and g.scope == scope]
            controls = f"Compare with {listed(ran)}." if ran else "No control for this ran."
            reasons.append(f"{', '.join(agents)}: {words} {controls}")
            sentence = said
    tone: Tone = "open" if reasons else "note"
    if trained := [group.name for group in task.groups if _privileged_uses(group)]:
        reasons.append(PRIVILEGED_TRAINING.format(agents=", ".join(trained)))
    return Verdict(sentence=f"{task.title}: {sentence}.", reasons=reasons, tone=tone)


def _privileged_uses(group: Group) -> list[str]:
    """List what the training used the simulator's state for, besides the reward."""
    config = group.runs[0].config
    return privileged_uses(config["algorithm"]) + ["grounding"] * bool(config.get("grounding"))


def _overview(task: TaskData) -> DataTable:
    """List the source, size and norm of each agent's vector."""
    rows: list[Row] = []
    for group in task.groups:
        known = _known(group.runs[0])
        slots = known.get("slots") or []
        row: Row = {"agent": group.name, "source": _source(known) if slots else None}
        row |= {"slots": len(slots), "numbers": known.get("dim", 0), "norm": known.get("norm")}
        row |= {flag: bool(known.get(flag)) for flag in ("constant", "privileged")}
        row |= {"training": ", ".join(_privileged_uses(group)), "note": known.get("note", "")}
        row["coverage"] = known.get("coverage", {}).get("share") if slots else None
        rows.append(row)
    columns: list[str | Column] = [
        *("agent", "source", Column("slots", "slots", "integer")),
        *(Column("numbers", "dimensions", "integer"), Column("norm", "norm", "number")),
        Column("coverage", "words with a vector", "percent"),
        *("constant", "privileged"),
        *(Column("training", "simulator's state in training"), "note"),
    ]
    sources = [group.runs[0].path / "provenance.json" for group in task.groups]
    return table_of(task, "knowledge", "Knowledge vectors", columns, rows, sources)


def _config(known: Mapping[str, Any]) -> KnowledgeConfig:
    return from_dict(KnowledgeConfig, known["config"], where="knowledge")


def _source(known: Mapping[str, Any]) -> str | None:
    with suppress(UserError, KeyError):  # of another version
        return _config(known).source.short_name
    return None


def _knowledge(group: Group, stem: str, known: Mapping[str, Any], graphs: set[str]) -> list[Block]:
    """Show the graph, the sentences and the vector; ``graphs`` holds the graphs drawn so far."""
    run, name = group.runs[0], group.name
    blocks, left, right = [], [], []  # type: list[Block], list[Block], list[Block]
    try:
        triples = _triples(run, known)
    except Exception as error:  # whatever a damaged graph or config raises
        triples = []
        blocks.append(Verdict(sentence=f"The graph of {name} cannot be reconstructed: {error}"))
    if triples and (key := json.dumps(triples)) not in graphs:
        graphs.add(key)
        left.append(_graph(name, stem, triples, run))
    matrix = _matrix(run, known)
    if matrix is not None:
        right.append(_vector(name, stem, run, known, matrix))
    sentences = known.get("sentences") or {}
    if any(sentences.values()):
        table = DataTable(
            name=f"sentences-{stem}",
            title=f"Sentence of each slot: {name}",
            columns=shared("slot", "sentence"),
            rows=[{"slot": slot, "sentence": each} for slot, each in sentences.items()],
            sources=[run.path / "provenance.json"],
        )
        right.append(table)
    pair = Pair(left=left, right=right) if left else Pair(left=right[:1], right=right[1:])
    return [*blocks, pair]


def _triples(run: RunData, known: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    facets = known.get("facets") or run.provenance.get("facets")
    if not facets or known.get("config", {}).get("detail") == "none":
        return []
    return list(scene_subgraph(_config(known), [(a, b) for a, b in facets]))


def _graph(name: str, stem: str, triples: list[tuple[str, str, str]], run: RunData) -> Figure:
    words = [(a.replace("_", " "), b.replace("_", " "), c.replace("_", " ")) for a, b, c in triples]
    title = f"Facts of the graph about the objects: {len(triples)}"
    return Figure(
        table=DataTable(
            name=f"graph-{stem}",
            title=f"Subgraph of the perceived objects: {name}",
            columns=shared("head", "relation", "tail"),
            rows=[{"head": a, "relation": b, "tail": c} for a, b, c in triples],
            sources=[run.path / "config.json"],
        ),
        caption="Left: objects. Right: facts about them, by relation. A fact that two objects "
        "share has two lines.",
        panels=[Panel(svg=graph_diagram(words, title))],
    )


def _matrix(run: RunData, known: Mapping[str, Any]) -> np.ndarray | None:
    """Return the vector as (slots, dimensions): a table row cut into slots, or the table's rows."""
    table, slots = _table(run), len(known["slots"])
    if table is None or table.size == 0 or table.ndim != 2:
        return None
    if known.get("constant") or len(table) == 1 or np.ptp(table, axis=0).max() == 0:
        return table[0].reshape(slots, -1) if table.shape[1] % slots == 0 else table[:1]
    return np.unique(table, axis=0) if len(table) != slots else table


def _vector(
    name: str, stem: str, run: RunData, known: Mapping[str, Any], matrix: np.ndarray
) -> Figure:
    names = list(map(str, known["slots"]))
    if len(names) != len(matrix):
        names = [f"row {i + 1}" for i in range(len(matrix))]
    norm = float(np.linalg.norm(matrix.astype(np.float64)))
    shape = f"{matrix.size} numbers, {len(matrix)} slots of {matrix.shape[1]}, norm {norm:.2f}"
    if len(matrix) > MOST_SLOTS:  # one row per query: the page would grow to 20 MB
        shape += f"; shown are the first {MOST_SLOTS}"
        matrix, names = matrix[:MOST_SLOTS], names[:MOST_SLOTS]
    rows = [
        {"slot": slot, "index": i, "value": value}
        for slot, vector in zip(names, matrix.tolist(), strict=True)
        for i, value in enumerate(vector)
    ]
    return Figure(
        table=DataTable(
            name=f"vector-{stem}",
            title=f"Knowledge vector: {name}",
            columns=shared("slot", *VECTOR_COLUMNS),
            rows=rows,
            sources=[run.path / "knowledge.safetensors"],
        ),
        caption=f"{shape}. Orange above zero, blue below, pale near zero.",
        panels=[Panel(svg=heat_map(matrix, names, f"Knowledge vector of {name}: {shape}"))],
    )


def _parameters(task: TaskData) -> list[Block]:
    """Draw the trainable parameters by part; nothing if no run stored its counts."""
    counts: dict[str, dict[str, int]] = {}
    rows: list[Row] = []
    sources = []
    for group in task.groups:
        run = group.runs[0]
        if parts := {part: n for part, n in run.parameters.items() if part != "total" and n}:
            counts[group.name] = parts
            sources.append(run.path / "provenance.json")
            rows += [{"agent": group.name, "part": p, "parameters": n} for p, n in parts.items()]
    if not counts:
        return []
    names = dict.fromkeys(part for each in counts.values() for part in each)
    columns = ["agent", "part", "parameters"]
    table = table_of(task, "parameters", "Trainable parameters", columns, rows, sources)
    caption = "A longer vector makes a larger LSTM: compare agents of equal size."
    panels = [Panel(svg=stacked_bars(counts, "Trainable parameters by part of the network"))]
    legend = [(part, SHADES[i % len(SHADES)]) for i, part in enumerate(names)]
    return [Figure(table=table, caption=caption, panels=panels, legend=legend)]
