"""Page "Inputs": the knowledge graph, sentences and vector of each agent, and network sizes."""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from knowarm.config import from_dict
from knowarm.errors import UserError
from knowarm.experiment.run_folder import RunFolder
from knowarm.knowledge import KnowledgeConfig, scene_subgraph
from knowarm.learn.config import privileged_uses
from knowarm.report.blocks import (
    Block,
    Column,
    Figure,
    Pair,
    Panel,
    Row,
    Table,
    Tone,
    Verdict,
    shared,
)
from knowarm.report.diagrams import SHADES, graph_diagram, heat_map, stacked_bars
from knowarm.report.format import listed, slugs
from knowarm.report.study import CONTROLS, Group, Run, Task

MOST_VECTORS = 4
"""Distinct knowledge vectors that are drawn; the table lists all."""

MOST_SLOTS = 24
"""Slots of a knowledge vector that the page shows; the run folder has all of them."""

CONSTANT = (
    "{agents}: every episode has the same vector. For the network such an input is a bias with "
    "its own learning rate and additional capacity; it cannot tell episodes apart. {controls}"
)
PRIVILEGED = (
    "{agents}: the vector identifies the target of the episode, which no camera observed. "
    "{controls}"
)
TOLD = "{agents}: the vector describes what the episode asks for. {controls}"
PERCEIVED = (
    "{agents}: the vector describes what a perception module names in the first image of the "
    "episode. {controls}"
)

PRIVILEGED_TRAINING = (
    "{agents}: training used the simulator's state. The policy receives the image alone, in "
    "training and in every evaluation."
)


def input_blocks(task: Task) -> list[Block]:
    """Show the graph, the sentences, the vector, and how many parameters receive it."""
    blocks: list[Block] = [_kind_of_input(task), _overview(task)]
    stems = slugs(group.name for group in task.groups)
    drawn: set[str] = set()
    graphs: set[str] = set()
    # Controls last: their vectors are derived from those of the other agents.
    for group in sorted(task.groups, key=lambda g: (g.role in CONTROLS, g not in task.subjects)):
        known = _known(group.runs[0])
        key = json.dumps(known.get("config", known), sort_keys=True)
        if known.get("slots") and key not in drawn and len(drawn) < MOST_VECTORS:
            drawn.add(key)
            blocks += _knowledge(group, f"{task.name}-{stems[group.name]}", known, graphs)
    return [*blocks, *_parameters(task)]


def _known(run: Run) -> Mapping[str, Any]:
    """Return the description of a run's knowledge vector; empty if the network received none."""
    table = _table(run)
    if table is not None and table.size == 0:
        return {}
    return run.provenance.get("knowledge") or {}


def _table(run: Run) -> np.ndarray | None:
    """Read the knowledge table (F, K) of a run; None if it cannot be read."""
    try:
        return RunFolder(run.path).knowledge()
    except UserError:
        return None


def _kind_of_input(task: Task) -> Verdict:
    """State which agents have a constant vector and which a privileged one."""
    known = {group.name: _known(group.runs[0]) for group in task.groups}
    told, perceived = (
        [g.name for g in task.groups if g.scope == scope and known[g.name]]
        for scope in ("query", "perceived")
    )
    constant, privileged = (
        [name for name, each in known.items() if each.get(field)]
        for field in ("constant", "privileged")
    )
    reasons = []
    for agents, words, role, scope in (
        (constant, CONSTANT, "capacity_control", "scene"),
        (privileged, PRIVILEGED, "content_control", "target"),
        (told, TOLD, "content_control", "query"),
        (perceived, PERCEIVED, "content_control", "perceived"),
    ):
        if agents:
            ran = [g.name for g in task.groups if g.role == role and g.scope == scope]
            controls = f"Compare with {listed(ran)}." if ran else "No control for this ran."
            reasons.append(words.format(agents=", ".join(agents), controls=controls))
    if privileged:
        sentence = "some knowledge vectors are privileged"
    elif told:
        sentence = "the knowledge vector describes the query of the episode"
    elif perceived:
        sentence = "the knowledge vector describes what is perceived"
    elif reasons:
        sentence = "the knowledge vector is a constant input, which is a bias"
    else:
        sentence = "no agent received a knowledge vector"
    tone: Tone = "open" if reasons else "note"
    if learned := [group.name for group in task.groups if _privileged_uses(group)]:
        reasons.append(PRIVILEGED_TRAINING.format(agents=", ".join(learned)))
    return Verdict(sentence=f"{task.title}: {sentence}.", reasons=reasons, tone=tone)


def _privileged_uses(group: Group) -> list[str]:
    """List what the training used the simulator's state for, besides the reward."""
    config = group.runs[0].config
    grounding = ["grounding"] if config.get("grounding") else []
    return [*privileged_uses(config["algorithm"]), *grounding]


def _overview(task: Task) -> Table:
    """List the source, size and norm of each agent's vector."""
    rows: list[Row] = []
    for group in task.groups:
        known = _known(group.runs[0])
        coverage = known.get("coverage")
        share = coverage.get("share") if isinstance(coverage, Mapping) else coverage
        slots = known.get("slots") or []
        rows.append(
            {
                "agent": group.name,
                "source": _source(known) if slots else None,
                "slots": len(slots),
                "numbers": known.get("dim", 0) or 0,
                "norm": known.get("norm"),
                "coverage": share if slots else None,
                "constant": bool(known.get("constant")),
                "privileged": bool(known.get("privileged")),
                "training": ", ".join(_privileged_uses(group)),
                "note": known.get("note") or "",
            }
        )
    return Table(
        name=f"knowledge-{task.name}",
        title=f"Knowledge vectors: {task.title}",
        columns=[
            *shared("agent"),
            Column("source", "source"),
            Column("slots", "slots", "integer"),
            Column("numbers", "dimensions", "integer"),
            Column("norm", "norm", "number"),
            Column("coverage", "words with a vector", "percent"),
            Column("constant", "constant"),
            Column("privileged", "privileged"),
            Column("training", "simulator's state in training"),
            Column("note", "note"),
        ],
        rows=rows,
        sources=[group.runs[0].path / "provenance.json" for group in task.groups],
    )


def _config(known: Mapping[str, Any]) -> KnowledgeConfig:
    return from_dict(KnowledgeConfig, known["config"], where="knowledge")


def _source(known: Mapping[str, Any]) -> str | None:
    try:
        return _config(known).source.short_name
    except (UserError, KeyError):  # of another version
        return None


def _knowledge(group: Group, stem: str, known: Mapping[str, Any], graphs: set[str]) -> list[Block]:
    """Show the graph, the sentences and the vector; ``graphs`` holds the graphs drawn so far."""
    run, name = group.runs[0], group.name
    blocks: list[Block] = []
    left: list[Block] = []
    right: list[Block] = []
    try:
        triples = _triples(run, known)
    except (UserError, OSError, KeyError, TypeError, ValueError) as error:
        triples = []
        blocks.append(Verdict(sentence=f"The graph of {name} cannot be reconstructed: {error}"))
    key = json.dumps(triples)
    if triples and key not in graphs:
        graphs.add(key)
        left.append(_graph(name, stem, triples, run))
    matrix = _matrix(run, known)
    if matrix is not None:
        right.append(_vector(name, stem, run, known, matrix))
    sentences = known.get("sentences") or {}
    if any(sentences.values()):
        right.append(
            Table(
                name=f"sentences-{stem}",
                title=f"Sentence of each slot: {name}",
                columns=[Column(key, key) for key in ("slot", "sentence")],
                rows=[{"slot": slot, "sentence": each} for slot, each in sentences.items()],
                sources=[run.path / "provenance.json"],
            )
        )
    pair = Pair(left=left, right=right) if left else Pair(left=right[:1], right=right[1:])
    return [*blocks, pair]


def _triples(run: Run, known: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    facets = known.get("facets") or run.provenance.get("facets")
    if not facets or known.get("config", {}).get("detail") == "none":
        return []
    return list(scene_subgraph(_config(known), [(str(a), str(b)) for a, b in facets]))


def _graph(name: str, stem: str, triples: list[tuple[str, str, str]], run: Run) -> Figure:
    words = [(a.replace("_", " "), b.replace("_", " "), c.replace("_", " ")) for a, b, c in triples]
    title = f"Facts of the graph about the objects: {len(triples)}"
    return Figure(
        title=f"Subgraph of the perceived objects: {name}",
        caption="Left: objects. Right: facts about them, by relation. A fact that two objects "
        "share has two lines.",
        panels=[Panel(svg=graph_diagram(words, title))],
        table=Table(
            name=f"graph-{stem}",
            title="Facts",
            columns=[Column(key, key) for key in ("head", "relation", "tail")],
            rows=[{"head": a, "relation": b, "tail": c} for a, b, c in triples],
            sources=[run.path / "config.json"],
        ),
    )


def _matrix(run: Run, known: Mapping[str, Any]) -> np.ndarray | None:
    """Return the vector as (slots, dimensions): a table row cut into slots, or the table's rows."""
    table, slots = _table(run), len(known["slots"])
    if table is None or table.size == 0 or table.ndim != 2:
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
    if len(matrix) > MOST_SLOTS:  # one row per query: the page would grow to 20 MB
        shape += f"; shown are the first {MOST_SLOTS}"
        matrix, names = matrix[:MOST_SLOTS], names[:MOST_SLOTS]
    return Figure(
        title=f"Knowledge vector: {name}",
        caption=f"{shape}. Orange above zero, blue below, pale near zero.",
        panels=[Panel(svg=heat_map(matrix, names, f"Knowledge vector of {name}: {shape}"))],
        table=Table(
            name=f"vector-{stem}",
            title="Elements of the vector",
            columns=[
                Column("slot", "slot"),
                Column("index", "index", "integer"),
                Column("value", "value", "number3"),
            ],
            rows=[
                {"slot": slot, "index": i, "value": float(value)}
                for slot, vector in zip(names, matrix, strict=True)
                for i, value in enumerate(vector)
            ],
            sources=[run.path / "knowledge.safetensors"],
        ),
    )


def _parameters(task: Task) -> list[Block]:
    """Draw the trainable parameters by part; nothing if no run stored its counts."""
    counts, sources = {}, []
    for group in task.groups:
        run = group.runs[0]
        parts = {part: int(n) for part, n in run.parameters.items() if part != "total" and n}
        if parts:
            counts[group.name] = parts
            sources.append(run.path / "provenance.json")
    if not counts:
        return []
    names = dict.fromkeys(part for each in counts.values() for part in each)
    return [
        Figure(
            title=f"Trainable parameters: {task.title}",
            caption="A longer vector makes a larger LSTM: compare agents of equal size.",
            panels=[Panel(svg=stacked_bars(counts, "Trainable parameters by part of the network"))],
            legend=[(part, SHADES[i % len(SHADES)]) for i, part in enumerate(names)],
            table=Table(
                name=f"parameters-{task.name}",
                title="Trainable parameters",
                columns=[
                    *shared("agent"),
                    Column("part", "part"),
                    Column("parameters", "parameters", "integer"),
                ],
                rows=[
                    {"agent": name, "part": part, "parameters": number}
                    for name, parts in counts.items()
                    for part, number in parts.items()
                ],
                sources=sources,
            ),
        )
    ]
