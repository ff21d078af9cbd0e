"""Claims of one task go in; the knowledge agent against each control comes out."""

from knowarm.report import format
from knowarm.report.blocks import Block, Column, Figure, Panel, Row, Table
from knowarm.report.claims import Claim
from knowarm.report.levels import cells
from knowarm.report.pages.differences.comparisons import forest
from knowarm.report.study import Group, Task

ASKS = {
    "bm": "no knowledge, smaller network: the paper's comparison",
    "partial": "object types without colours",
    "wide": "no knowledge, same size: does the size explain it?",
    "zeros": "same input width, all zeros: does the wider input explain it?",
    "random": "random numbers of the same norm: does any vector do?",
    "shuffled": "the same graph with its facts mixed up: does the content matter?",
    "onehot": "slot numbers without meaning: does identity suffice?",
    "wrong-object": "true facts about other objects: does the right object matter?",
    "learned": "numbers the policy learns itself: is given knowledge better?",
    "target": "the episode's own object, privileged: what could an informative vector gain?",
    "target-onehot": "the episode's facet as a number, privileged: identity without meaning",
}


def controls(task: Task, asked: Group, claims: list[Claim]) -> list[Block]:
    """The difference to every control, with what the control asks and how large it is."""
    final = [claim for claim in claims if claim.outcome == "success"]
    compared = [claim for claim in final if claim.comparison]
    size = _size(asked)
    rows: list[Row] = []
    for claim in final:
        parameters = _size(claim.second)
        row: Row = {
            "control": claim.second.name,
            "asks": ASKS.get(claim.second.agent, "another setting"),
            "parameters": parameters,
            "equal": None if not (size and parameters) else abs(parameters / size - 1) <= 0.02,
            "adjusted_p": claim.adjusted_p,
            "verdict": claim.verdict,
        }
        if claim.comparison:
            row |= cells("difference", claim.comparison.difference)
        rows.append(row)
    table = Table(
        name=f"controls-{task.name}",
        title=f"{asked.name} against each control: {task.title}",
        columns=[
            Column(key="control", label="control"),
            Column(key="asks", label="what it asks"),
            Column(key="parameters", label="parameters", format="integer"),
            Column(key="equal", label=f"as many as {asked.name}", hint="within 2 %"),
            Column(key="difference", label="success [points]", format="points", interval=True),
            Column(key="adjusted_p", label="adjusted p", format="p"),
            Column(key="verdict", label=f"{asked.name} is"),
        ],
        rows=rows,
        sources=[run.path for run in task.runs],
        note=f"{asked.name} has {format.integer(size)} trainable parameters.",
    )
    if not compared:
        return [table]
    return [
        Figure(
            title=f"{asked.name} minus each control: {task.title}",
            caption="Success after training, percentage points, 95 % interval over training seeds. "
            "Right of the line: the knowledge agent is ahead.",
            panels=[Panel(svg=forest(compared, f"success after training, {task.title}"))],
            table=table,
            open_table=True,
        )
    ]


def _size(group: Group) -> int | None:
    for run in group.runs:
        total = run.provenance.get("parameter_counts", {}).get("total")
        if total:
            return int(total)
    return None
