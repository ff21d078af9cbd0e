"""Page "Inputs": the knowledge vector of each agent, its sentences, and network sizes."""

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from knowarm.errors import UserError
from knowarm.experiment.run_folder import RunFolder
from knowarm.knowledge.config import EmbeddingFacts
from knowarm.learn.algorithms import privileged_uses
from knowarm.report.blocks import (
    Block,
    Column,
    DataTable,
    Row,
    Tone,
    Verdict,
    shared,
    table_of,
)
from knowarm.report.format import listed, slugs
from knowarm.report.model import CONTROLS, Group, RunData, TaskData

KINDS = (
    (
        "every episode has the same vector. For the network such an input is a bias with its own "
        "learning rate and additional capacity; it cannot tell episodes apart.",
        *("the knowledge vector is a constant input, which is a bias", "capacity_control", "scene"),
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

PRIVILEGED_TRAINING = (
    "{agents}: training used the simulator's state. The policy never receives it: its "
    "inputs are the image and the vector below."
)

PRIVILEGED_NOTE = (
    "What the simulator's state is used for in training: the critic's network values states; the "
    "features of the image predict joints and grasp pose (auxiliary loss); each step towards the "
    "grasp pose is rewarded (progress reward); inverse kinematics labels images with actions "
    "(teacher), where episodes start on its way (practice starts), and at first each image is of a "
    "new episode (glimpses); the network that finds objects learns from labels (grounding)."
)


def input_blocks(task: TaskData) -> list[Block]:
    """Show what each agent's vector says, and how many parameters receive it."""
    blocks: list[Block] = [_kind_of_input(task), _overview(task)]
    stems = slugs(group.name for group in task.groups)
    listed_sentences = list[Mapping[str, Any]]()
    # Controls last: their vectors are derived from those of the other agents.
    for group in sorted(task.groups, key=lambda g: (g.role in CONTROLS, g not in task.subjects)):
        knowledge = _knowledge_of(group.runs[0])
        sentences = knowledge.sentences if knowledge else {}
        if any(sentences.values()) and sentences not in listed_sentences:
            listed_sentences.append(sentences)
            blocks.append(
                DataTable(
                    name=f"sentences-{task.name}-{stems[group.name]}",
                    title=f"Sentence of each slot: {group.name}",
                    columns=shared("slot", "sentence"),
                    rows=[{"slot": slot, "sentence": each} for slot, each in sentences.items()],
                    sources=[group.runs[0].path / "provenance.json"],
                )
            )
    return [*blocks, *_parameters(task)]


def _knowledge_of(run: RunData) -> EmbeddingFacts | None:
    """Return the description of a run's knowledge vector; None if the network received none."""
    with suppress(UserError):  # a table that cannot be read
        if not RunFolder(run.path).knowledge().size:
            return None
    return run.provenance.knowledge


def _kind_of_input(task: TaskData) -> Verdict:
    """State which agents have a constant vector and which a privileged one."""
    knowledge = {group.name: _knowledge_of(group.runs[0]) for group in task.groups}
    sentence, reasons = "no agent received a knowledge vector", []
    for words, said, role, scope in KINDS:
        if scope == "query":
            agents = [g.name for g in task.groups if g.scope == scope and knowledge[g.name]]
        else:
            flag = "constant" if scope == "scene" else "privileged"
            agents = [name for name, each in knowledge.items() if each and getattr(each, flag)]
        if agents:
            ran = [g.name for g in task.groups if g.role == role and g.scope == scope]
            controls = f"Compare with {listed(ran)}." if ran else "No control for this ran."
            reasons.append(f"{', '.join(agents)}: {words} {controls}")
            sentence = said
    tone: Tone = "open" if reasons else "note"
    if trained := [group.name for group in task.groups if _privileged_uses(group)]:
        reasons.append(PRIVILEGED_TRAINING.format(agents=", ".join(trained)))
    return Verdict(sentence=f"{sentence[0].upper()}{sentence[1:]}.", reasons=reasons, tone=tone)


def _privileged_uses(group: Group) -> list[str]:
    """List what the training used the simulator's state for, besides the reward."""
    run = group.runs[0]
    uses = privileged_uses(run.settings["algorithm"])
    if run.config.knows.grounding is not None:
        uses.append("grounding")
    return uses


def _overview(task: TaskData) -> DataTable:
    """List the source, size and norm of each agent's vector."""
    rows: list[Row] = []
    for group in task.groups:
        row: Row = {"agent": group.name, "training": ", ".join(_privileged_uses(group))}
        row |= {"slots": 0, "numbers": 0, "constant": False, "privileged": False}
        if knowledge := _knowledge_of(group.runs[0]):
            row |= {"slots": len(knowledge.slots), "numbers": knowledge.dim, "norm": knowledge.norm}
            row |= {
                "constant": knowledge.constant,
                "privileged": knowledge.privileged,
                "note": knowledge.note,
            }
            if knowledge.slots:
                row |= {"source": knowledge.source}
                row |= {"coverage": knowledge.coverage["share"]}
        rows.append(row)
    columns: list[str | Column] = [
        *("agent", "source", Column("slots", "slots", "integer")),
        *(Column("numbers", "dimensions", "integer"), Column("norm", "norm", "number")),
        Column("coverage", "words with a vector", "percent"),
        *("constant", "privileged"),
        *(Column("training", "simulator's state in training"), "note"),
    ]
    sources = [group.runs[0].path / "provenance.json" for group in task.groups]
    note = PRIVILEGED_NOTE if any(map(_privileged_uses, task.groups)) else ""
    return table_of(task, "knowledge", "Knowledge vectors", columns, rows, sources, note)


def _parameters(task: TaskData) -> list[Block]:
    """List the trainable parameters by part; nothing if no run stored its counts."""
    stored = [(group, group.runs[0]) for group in task.groups]
    stored = [(group, run) for group, run in stored if run.provenance.parameter_counts]
    rows: list[Row] = [{"agent": g.name, **run.provenance.parameter_counts} for g, run in stored]
    parts = dict.fromkeys(part for row in rows for part in row if row[part] and part != "agent")
    if not parts:
        return []
    columns: list[str | Column] = ["agent", *(Column(part, part, "integer") for part in parts)]
    sources = [run.path / "provenance.json" for _, run in stored]
    note = "A longer vector makes a larger LSTM: compare agents of equal size."
    title = "Trainable parameters by part of the network"
    return [table_of(task, "parameters", title, columns, rows, sources, note)]
