"""Pages "Summary" and "Runs": verdicts and success in total; the run folders and their defects."""

from collections.abc import Sequence

from knowarm.experiment.agents import AGENTS
from knowarm.report.blocks import (
    Block,
    Column,
    DataTable,
    Figure,
    Folded,
    Panel,
    Row,
    Text,
    Verdict,
    row_of,
    shared,
)
from knowarm.report.charts import RETURN_AXIS, SUCCESS_AXIS, near
from knowarm.report.diagrams import dot_chart, group_dot
from knowarm.report.format import counted
from knowarm.report.model import RunData, StudyData
from knowarm.report.pages.results import conditions
from knowarm.report.verdicts.claims import Claim, Finding
from knowarm.report.verdicts.knowledge import answer, tested_findings
from knowarm.report.verdicts.learning import learning_verdict, vision_verdict
from knowarm.report.verdicts.query import query_summary

VERSIONS = ("knowarm", "torch", "mujoco")
FOLDER = Column("folder", "folder", "path")


def run_blocks(study: StudyData) -> list[Block]:
    """List every remark on a folder, and every run with its versions and machine."""
    runs = DataTable(
        name="runs",
        title="Runs",
        columns=shared("task", "agent", "seed", FOLDER, "commit", *VERSIONS, "machine"),
        rows=[
            {"task": task.title, "agent": group.name, "seed": run.config.seed, "folder": run.path}
            | _origin(run)
            for task in study.tasks
            for group in task.groups
            for run in group.runs
        ],
        sources=[run.path / "provenance.json" for run in study.runs],
    )
    if not study.problems:
        return [Text(paragraphs=["Nothing is missing or damaged in the folders."]), runs]
    path = Column("path", "folder or file", "path")
    problems = DataTable(
        name="problems",
        title="Remarks on the folders",
        columns=[path, Column("what", "found"), Column("done", "handled as")],
        rows=[problem._asdict() for problem in study.problems],
    )
    return [problems, runs]


def _origin(run: RunData) -> Row:
    """Return the commit, the versions and the machine of a run."""
    provenance = run.provenance
    versions = {name: provenance.versions.get(name) for name in VERSIONS}
    return {
        "commit": (provenance.commit or "")[:10],
        "machine": provenance.machine.get("processor"),
    } | versions


KEYS = ("success", "choice", "accuracy", "return_mean")  # numbers of the table, where known


def summary_blocks(
    study: StudyData, decided: list[Claim], understood: Sequence[Finding]
) -> list[Block]:
    """State what the runs show, in sentences generated from their numbers, then the numbers."""
    every: list[Finding] = []
    reasons: list[Block] = []
    doubts: list[Block] = []
    for task in study.tasks:
        every += (mine := tested_findings(task, decided))
        reasons += [each.verdict(shown_reasons=1) for each in mine]
        reasons += query_summary([each for each in understood if each.task is task])
        for verdict in filter(None, (learning_verdict(task), vision_verdict(task))):
            (reasons if verdict.tone == "good" else doubts).append(verdict)
    blocks = [answer([*every, *understood], len(study.tasks)), *doubts]
    if any(task.label for task in study.tasks):
        blocks.append(_results(study))
    if study.problems:
        remarks = f"{counted(len(study.problems), 'remark')} on the run folders"
        sentence = f"Before these numbers are used, read the {remarks}."
        reason = "The page Runs lists what is missing or damaged, and how it was handled."
        blocks.append(Verdict(tone="bad", sentence=sentence, reasons=[reason]))
    return [*blocks, Folded(title="Reasons, task by task", blocks=reasons)]


def _results(study: StudyData) -> Figure:
    rows: list[Row] = []
    panels: list[Panel] = []
    alone = len(study.tasks) == 1
    compared = [(task, (*task.groups, *task.references)) for task in study.tasks]
    reached = [s for _, lines in compared for each in lines for s in each.scores("success")]
    measures = {"success": near(SUCCESS_AXIS, reached)} | (
        {"return_mean": RETURN_AXIS} if alone else {}
    )
    for task, lines in compared:
        keys = (*KEYS, "vision_gain")
        rows += [{"task": task.title} | row_of(task, each, *keys) for each in lines]
        for key, axis in measures.items():
            dots = [group_dot(each, key, task.colours) for each in lines]
            name = f"{axis.title} of each agent on {task.title}"
            title = axis.title if alone else task.title
            panels.append(Panel(svg=dot_chart(dots, name, axis, left=124), title=title))
    first = next((e for task in study.tasks for g in task.groups for e in g.evaluations), None)
    agents = dict.fromkeys(group.agent for task in study.tasks for group in task.groups)
    known = [f"{name}: {AGENTS[name].about}" for name in agents if name in AGENTS]
    measured = [key for key in KEYS if any(row[key] is not None for row in rows)]
    return Figure(
        table=DataTable(
            name="summary",
            title="Success, accuracy and return after training",
            columns=shared(*["task"] * (not alone), "agent", *measured, "vision_gain", "seeds"),
            rows=rows,
            sources=[run.path for run in study.runs],
            note=f"{conditions(first)}. {'; '.join(known)}. Success: distance and angle within the "
            "thresholds at once. Accuracy: final distance within the threshold, as in the paper. "
            "Depends on vision: success minus that of the better agent that sees nothing.",
        ),
        caption="Dot: mean over training seeds. Line: 95 % interval, over seeds where there are "
        "several, over episodes where there is one. Small dots: single seeds.",
        panels=panels,
        open_table=True,
    )
