"""Page "Knowledge": each subject against the controls, and under other conditions."""

from collections import Counter
from collections.abc import Mapping, Sequence

from knowarm.experiment.agents import AGENTS
from knowarm.report import format
from knowarm.report.blocks import Block, Column, DataTable, Figure, Panel, Row, table_of
from knowarm.report.charts import POINTS_AXIS
from knowarm.report.collect import evaluation_sets
from knowarm.report.diagrams import Dot, dot_chart
from knowarm.report.format import slugs
from knowarm.report.model import Evaluated, Group, TaskData
from knowarm.report.pages.results import conditions
from knowarm.report.verdicts.claims import TOLERANCE, Claim, size_of
from knowarm.report.verdicts.knowledge import finding
from knowarm.statistics import welch

EXPLANATION = (
    "A vector that is the same in every episode carries no information about the episode: for the "
    "network it is a bias. It can still change learning, because it makes the network larger and "
    "because its weights have a gradient of their own. An advantage over the baseline alone is "
    "therefore no evidence for knowledge. What counts is the advantage over controls that differ "
    "in the knowledge only."
)


def knowledge_blocks(task: TaskData, decided: list[Claim]) -> list[Block]:
    """Compare each subject with every other agent, and under other conditions."""
    blocks: list[Block] = []
    for subject in task.subjects if len(task.groups) > 1 else ():
        stem = "" if subject is task.subjects[0] else f"-{slugs([subject.name])[subject.name]}"
        mine = [claim for claim in decided if claim.task is task and claim.first is subject]
        final = [claim for claim in mine if claim.outcome == "success"]
        blocks += [
            finding(task, decided, "success", subject).verdict(),
            finding(task, decided, "speed", subject).verdict(),
            _controls(task, subject, final, stem),
            *_other_conditions(task, subject, stem),
        ]
    return blocks


def _controls(task: TaskData, subject: Group, final: list[Claim], stem: str) -> Block:
    """Show the difference to every other agent, with its role and its size."""
    size = size_of(subject, "parameters")
    rows: list[Row] = []
    for claim in final:
        if (other := claim.second) is None:
            continue
        parameters = size_of(other, "parameters")
        row: Row = {
            "control": other.name,
            "role": other.role.replace("_", " "),
            "about": AGENTS[other.agent].about if other.agent in AGENTS else None,
            "parameters": parameters,
            "equal": size and parameters and abs(parameters / size - 1) <= TOLERANCE,
            "adjusted_p": claim.adjusted_p,
            "verdict": claim.verdict,
        }
        if claim.comparison:
            row["difference"] = claim.comparison.difference
        rows.append(row)
    columns: list[str | Column] = [
        *(Column("control", "agent"), "role", "about", "parameters"),
        Column("equal", f"as many as {subject.name}", hint=f"within {TOLERANCE:.0%}"),
        Column("difference", "success [points]", "points", interval=True),
        *(Column("adjusted_p", "adjusted p", "p"), Column("verdict", f"{subject.name} is")),
    ]
    note = f"{subject.name} has {format.integer(size)} trainable parameters."
    title = f"{subject.name} against each other agent"
    table = table_of(task, "controls", title, columns, rows, note=note, stem=stem)
    caption = (
        "Success after training in percentage points, with the 95 % interval over training seeds. "
        f"Right of the line: {subject.name} is ahead."
    )
    return forest_figure(table, caption, {"": final})


def forest_figure(table: DataTable, caption: str, panels: Mapping[str, Sequence[Claim]]) -> Block:
    """Draw the intervals of the claims around zero, by title; the table alone if there are none."""
    drawn = []
    for title, claims in panels.items():
        dots = [
            Dot(
                name=f"{claim.first.name} \u2212 {claim.against}",
                colour=claim.task.colours[claim.against],
                value=claim.comparison.difference,
            )
            for claim in claims
            if claim.comparison
        ]
        if dots:
            name = f"{table.title}, {title}" if title else table.title
            svg = dot_chart(dots, name, POINTS_AXIS, zero=True, width=390, left=132)
            drawn.append(Panel(svg=svg, title=title))
    if not drawn:
        return table
    return Figure(table=table, caption=caption, panels=drawn, open_table=True)


def _other_conditions(task: TaskData, subject: Group, stem: str) -> list[Block]:
    """Show the evaluations under other labels, such as held-out colours or sampled actions."""
    sets = {key: each for key, each in evaluation_sets(task).items() if key[0] != task.label}
    rules = Counter(label for label, _ in sets)
    rows: list[Row] = []
    sources = []
    for (label, _), alike in sets.items():
        own = Evaluated(subject.name, alike.get(subject, [])).scores("success")
        for group, evaluations in alike.items():
            values = Evaluated(group.name, evaluations).scores("success")
            name = f"{label}: {conditions(evaluations[0])}" if rules[label] > 1 else label
            row: Row = {"label": name, "agent": group.name, "seeds": len(values)}
            row |= {"success": float(values.mean()), "_colour": task.colours[group.name]}
            if group is not subject and min(len(own), len(values)) > 1:
                row["difference"] = welch(own, values).difference
            rows.append(row)
            sources += [evaluation.folder for evaluation in evaluations]
    if not rows:
        return []
    columns: list[str | Column] = [
        *(Column("label", "evaluation"), "agent", "seeds", Column("success", "success", "percent")),
        Column("difference", f"{subject.name} minus it [points]", "points", interval=True),
    ]
    note = (
        "Evaluations stored under another label: held-out colours, other thresholds, sampled "
        "actions. 95 % intervals over training seeds, not corrected."
    )
    return [table_of(task, "elsewhere", "Other conditions", columns, rows, sources, note, stem)]
