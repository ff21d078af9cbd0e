"""Pages "Summary" and "Runs": verdicts and success in total; the run folders and their defects."""

from collections.abc import Sequence
from operator import itemgetter

from knowarm.experiment.agents import AGENTS
from knowarm.report.blocks import (
    Block,
    Figure,
    Folded,
    Row,
    TaskPart,
    Text,
    Verdict,
    row_of,
    table_of,
)
from knowarm.report.charts import RETURN_AXIS, SUCCESS_AXIS, near
from knowarm.report.diagrams import dot_panels
from knowarm.report.format import counted
from knowarm.report.model import Evaluated, RunData, StudyData
from knowarm.report.pages.results import conditions, first_evaluation
from knowarm.report.verdicts.claims import Claims, Finding
from knowarm.report.verdicts.knowledge import answer, tested_findings
from knowarm.report.verdicts.learning import learning_verdict, vision_verdict

VERSIONS = ("knowarm", "torch", "mujoco")
MEASURES = ("success", "choice", "accuracy", "return_mean")  # of the table, where known


def run_blocks(study: StudyData) -> list[Block]:
    """List every remark on a folder, and every run with its versions and machine."""
    rows = []
    for task in study.tasks:
        for group in task.groups:
            origin = {"task": task.title, "agent": group.name}
            rows += [origin | _origin(run) for run in group.runs]
    runs = table_of(study, "runs", rows)
    if not study.problems:
        return [Text(["Nothing is missing or damaged in the folders."]), runs]
    remarks = [problem._asdict() for problem in study.problems]
    return [table_of(study, "problems", remarks), runs]


def _origin(run: RunData) -> Row:
    """Return the seed, the folder, the commit, the versions and the machine of a run."""
    provenance = run.provenance
    row = {
        "seed": run.config.seed,
        "folder": run.path,
        "commit": (provenance.commit or "")[:10],
        "machine": provenance.machine.get("processor"),
    }
    for name in VERSIONS:
        row[name] = provenance.versions.get(name)
    return row


def summary_blocks(
    study: StudyData,
    decided: Claims,
    understood: Sequence[Finding],
) -> list[Block]:
    """State what the runs show, in sentences generated from their numbers, then the numbers."""
    findings: list[Finding] = []
    reasons: list[Block] = []
    doubts: list[Block] = []
    for task in study.tasks:
        of_task = [finding for finding in understood if finding.task is task]
        of_task = tested_findings(task, decided) + of_task
        findings += of_task
        blocks = [finding.verdict(shown_reasons=1) for finding in of_task]
        for verdict in (learning_verdict(task), vision_verdict(task)):
            if verdict:
                (blocks if verdict.tone == "good" else doubts).append(verdict)
        reasons.append(TaskPart(name=task.name, title=task.title, blocks=blocks))
    shown: list[Block] = [answer(findings, len(study.tasks)), *doubts]
    if any(task.label for task in study.tasks):
        shown.append(results_figure(study))
    if study.problems:
        remarks = f"{counted(len(study.problems), 'remark')} on the run folders"
        sentence = f"Before these numbers are used, read the {remarks}."
        reason = (
            "The page Runs lists what is missing or damaged, and how it was handled."
        )
        shown.append(Verdict(sentence, [reason], tone="bad"))
    return [*shown, Folded(title="Reasons, task by task", blocks=reasons)]


def results_figure(study: StudyData) -> Figure:
    """Draw the success of all agents, above the numbers of `MEASURES`."""
    scores: list[float] = []
    rows: list[Row] = []
    agents: list[Evaluated] = []
    abouts: dict[str, str] = {}
    for task in study.tasks:
        agents += task.agents
        for agent in task.agents:
            row = row_of(agent, *MEASURES, "vision_gain")
            rows.append(row | {"task": task.title, "_panel": task.title})
            scores += agent.scores("success").tolist()
        for group in task.groups:
            if group.agent in AGENTS:
                abouts[group.agent] = f"{group.agent}: {AGENTS[group.agent].about}"
    known = [key for key in MEASURES if any(map(itemgetter(key), rows))]
    several = ["task"] if len(study.tasks) > 1 else []
    columns = [*several, "agent", *known, "vision_gain", "seeds"]
    words = {
        "conditions": conditions(first_evaluation(agents)),
        "agents": "; ".join(abouts.values()),
    }
    table = table_of(study, "summary", rows, more=columns, **words)
    panels = dot_panels(table, "success", near(SUCCESS_AXIS, scores), seeds=True)
    if not several:
        panels += dot_panels(table, "return_mean", RETURN_AXIS, seeds=True)
    return Figure(table, panels, open_table=True)
