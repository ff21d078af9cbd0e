"""Page "Knowledge": each subject against the controls, and under other conditions."""

from collections import Counter

from knowarm.experiment.agents import AGENTS
from knowarm.report.blocks import (
    Block,
    DataTable,
    Figure,
    Row,
    row_of,
    table_of,
)
from knowarm.report.charts import POINTS_AXIS
from knowarm.report.diagrams import dot_panels
from knowarm.report.format import integer, slugs
from knowarm.report.model import Group, TaskData
from knowarm.report.pages.results import conditions
from knowarm.report.verdicts.claims import (
    OUTCOMES,
    TOLERANCE,
    Claim,
    Claims,
    claims_on,
    size_of,
)
from knowarm.report.verdicts.knowledge import finding
from knowarm.statistics import welch

EXPLANATION = (
    "A vector that is the same in every episode carries no information about the episode: for the "
    "network it is a bias. It can still change learning, because it makes the network larger and "
    "because its weights have a gradient of their own. An advantage over the baseline alone is "
    "therefore no evidence for knowledge. What counts is the advantage over controls that differ "
    "in the knowledge only.",
)


def knowledge_blocks(task: TaskData, decided: Claims) -> list[Block]:
    """Compare each subject with every other agent, and under other conditions."""
    blocks: list[Block] = []
    if len(task.groups) == 1:
        return blocks
    stem = ""
    for subject in task.subjects:
        if blocks:
            stem = slugs([subject.name])[subject.name]
        for outcome in OUTCOMES:
            found = finding(task, decided, outcome, subject)
            blocks.append(found.verdict())
        blocks.append(_controls(task, subject, decided, stem))
        blocks += _other_conditions(task, subject, stem)
    return blocks


def _controls(task: TaskData, subject: Group, decided: Claims, stem: str) -> Block:
    """Show the difference to every other agent, with its role and its size."""
    name = subject.name
    size = size_of(subject, "parameters")
    rows = []
    for claim in claims_on(decided, task, subject, "success"):
        other = claim.second
        if other is None:
            continue
        parameters = size_of(other, "parameters")
        row = claim_row(claim, "") | {
            "control": other.name,
            "role": other.role.replace("_", " "),
            "parameters": parameters,
            "equal": size and parameters and abs(parameters / size - 1) <= TOLERANCE,
        }
        if other.agent in AGENTS:
            row["about"] = AGENTS[other.agent].about
        rows.append(row)
    words = {
        "subject": name,
        "size": integer(size),
        "tolerance": f"{TOLERANCE:.0%}",
    }
    return forest_figure(table_of(task, "controls", rows, stem=stem, **words))


def claim_row(claim: Claim, panel: str) -> Row:
    """Return the difference that a claim decides on, drawn in the panel of a title."""
    row: Row = {"verdict": claim.verdict, "adjusted_p": claim.adjusted_p}
    if claim.comparison and claim.second:
        row["difference"] = claim.comparison.difference
        row["_panel"] = panel
        row["_name"] = f"{claim.first.name} \u2212 {claim.against}"
        row["_agent"] = claim.second
    return row


def forest_figure(table: DataTable) -> Block:
    """Draw the intervals of differences around zero; the table alone if there are none."""
    panels = dot_panels(table, "difference", POINTS_AXIS, zero=True, width=390)
    if not panels:
        return table
    return Figure(table, panels, open_table=True)


def _other_conditions(task: TaskData, subject: Group, stem: str) -> list[DataTable]:
    """Show the evaluations under other labels, such as held-out colours or sampled actions."""
    labels = Counter(label for label, _ in task.evaluation_sets)
    rows = []
    for (label, _), agents in task.evaluation_sets.items():
        if label == task.label:
            continue
        for group, agent in agents.items():
            row = row_of(agent)
            row["label"] = label
            if labels[label] > 1:
                row["label"] += f": {conditions(agent.evaluations[0])}"
            scores = agent.scores("success")
            row["success"] = scores.mean()
            if group is not subject and subject in agents:
                subject_scores = agents[subject].scores("success")
                if min(len(subject_scores), len(scores)) > 1:
                    row["difference"] = welch(subject_scores, scores).difference
            rows.append(row)
    if not rows:
        return []
    return [table_of(task, "elsewhere", rows, stem=stem, subject=subject.name)]
