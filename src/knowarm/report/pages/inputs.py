"""Page "Inputs": the knowledge vector of each agent, its sentences, and network sizes."""

from contextlib import suppress

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
    table_of,
)
from knowarm.report.format import listed, slugs
from knowarm.report.model import CONTROLS, Group, RunData, TaskData

Vectors = dict[str, EmbeddingFacts | None]
"""Description of each agent's knowledge vector; None if the network received none."""

KINDS = (
    (
        "every episode has the same vector. For the network such an input is a bias with its own "
        "learning rate and additional capacity; it cannot tell episodes apart.",
        "The knowledge vector is a constant input, which is a bias.",
        "capacity_control",
        "scene",
    ),
    (
        "the vector describes the query of the episode.",
        "The knowledge vector describes the query of the episode.",
        "content_control",
        "query",
    ),
    (
        "the vector identifies the target of the episode, which no camera observed.",
        "Some knowledge vectors are privileged.",
        "content_control",
        "target",
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
    vectors = {group.name: _knowledge_of(group.runs[0]) for group in task.groups}
    blocks: list[Block] = [_kind_of_input(task, vectors), _overview(task, vectors)]
    stems = slugs(group.name for group in task.groups)
    listed_before = []
    # Controls last: their vectors are derived from those of the other agents.
    for group in sorted(
        task.groups, key=lambda g: (g.role in CONTROLS, g not in task.subjects)
    ):
        knowledge = vectors[group.name]
        sentences = knowledge.sentences if knowledge else {}
        if any(sentences.values()) and sentences not in listed_before:
            listed_before.append(sentences)
            rows = [
                {"slot": slot, "sentence": words} for slot, words in sentences.items()
            ]
            stem = stems[group.name]
            table = table_of(task, "sentences", rows, stem=stem, agent=group.name)
            blocks.append(table)
    return blocks


def _knowledge_of(run: RunData) -> EmbeddingFacts | None:
    """Return the description of a run's knowledge vector; None if the network received none."""
    with suppress(UserError):  # a table that cannot be read
        if not RunFolder(run.path).knowledge().size:
            return None
    return run.provenance.knowledge


def _kind_of_input(task: TaskData, vectors: Vectors) -> Verdict:
    """State which agents have a constant vector and which a privileged one."""
    sentence = "No agent received a knowledge vector."
    reasons = []
    for about, about_task, role, scope in KINDS:
        agents = [group.name for group in task.groups if _is(scope, group, vectors)]
        if agents:
            ran = [g.name for g in task.groups if g.role == role and g.scope == scope]
            controls = "No control for this ran."
            if ran:
                controls = f"Compare with {listed(ran)}."
            reasons.append(f"{', '.join(agents)}: {about} {controls}")
            sentence = about_task
    tone: Tone = "open" if reasons else "note"
    trained = [group.name for group in task.groups if _privileged_uses(group)]
    if trained:
        reasons.append(PRIVILEGED_TRAINING.format(agents=", ".join(trained)))
    return Verdict(sentence, reasons, tone=tone)


def _is(scope: str, group: Group, vectors: Vectors) -> bool:
    """Return whether a group's vector is constant (scene), of the query, or privileged (target)."""
    knowledge = vectors[group.name]
    if not knowledge:
        return False
    if scope == "scene":
        return knowledge.constant
    if scope == "target":
        return knowledge.privileged
    return group.scope == scope


def _privileged_uses(group: Group) -> list[str]:
    """List what the training used the simulator's state for, besides the reward."""
    run = group.runs[0]
    uses = privileged_uses(run.settings["algorithm"])
    if run.config.knows.grounding is not None:
        uses.append("grounding")
    return uses


def _overview(task: TaskData, vectors: Vectors) -> DataTable:
    """List the source, size and norm of each agent's vector, and the parameters of its network."""
    note = ""
    rows = []
    parts = {}
    for group in task.groups:
        knowledge = vectors[group.name]
        counts = group.runs[0].provenance.parameter_counts
        for part in filter(counts.get, counts):
            parts[part] = Column(part, f"parameters: {part}", "integer")
        training = ", ".join(_privileged_uses(group))
        if training:
            note = PRIVILEGED_NOTE
        row: Row = {
            "agent": group.name,
            "training": training,
            "slots": 0,
            "numbers": 0,
            "constant": False,
            "privileged": False,
            **counts,
        }
        if knowledge:
            row |= {
                "slots": len(knowledge.slots),
                "numbers": knowledge.dim,
                "norm": knowledge.norm,
                "constant": knowledge.constant,
                "privileged": knowledge.privileged,
                "note": knowledge.note,
            }
            if knowledge.slots:
                row["source"] = knowledge.source
                row["coverage"] = knowledge.coverage["share"]
        rows.append(row)
    return table_of(task, "knowledge", rows, more=parts.values(), note=note)
