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
from knowarm.report.model import Evaluated, RunData, StudyData
from knowarm.report.pages.results import conditions, first_evaluation
from knowarm.report.verdicts.claims import Claim, Finding
from knowarm.report.verdicts.knowledge import answer, tested_findings
from knowarm.report.verdicts.learning import learning_verdict, vision_verdict
from knowarm.report.verdicts.query import query_summary

VERSIONS = ("knowarm", "torch", "mujoco")
RUN_COLUMNS = shared(
    "task",
    "agent",
    "seed",
    Column("folder", "folder", "path"),
    "commit",
    *VERSIONS,
    "machine",
)
PROBLEM_COLUMNS = (
    Column("path", "folder or file", "path"),
    Column("what", "found"),
    Column("done", "handled as"),
)
MEASURES = ("success", "choice", "accuracy", "return_mean")  # of the table, where known
SUMMARY_NOTE = (
    "{conditions}. {agents}. Success: distance and angle within the "
    "thresholds at once. Accuracy: final distance within the threshold, as in the paper. "
    "Depends on vision: success minus that of the better agent that sees nothing."
)
SUMMARY_CAPTION = (
    "Dot: mean over training seeds. Line: 95 % interval, over seeds where there are "
    "several, over episodes where there is one. Small dots: single seeds."
)


def run_blocks(study: StudyData) -> list[Block]:
    """List every remark on a folder, and every run with its versions and machine."""
    rows = []
    sources = []
    for task in study.tasks:
        for group in task.groups:
            for run in group.runs:
                rows.append({"task": task.title, "agent": group.name} | _origin(run))
                sources.append(run.path / "provenance.json")
    runs = DataTable("runs", "Runs", RUN_COLUMNS, rows, sources)
    if not study.problems:
        return [Text(["Nothing is missing or damaged in the folders."]), runs]
    remarks = [problem._asdict() for problem in study.problems]
    title = "Remarks on the folders"
    return [DataTable("problems", title, PROBLEM_COLUMNS, remarks), runs]


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
    study: StudyData, decided: list[Claim], understood: Sequence[Finding]
) -> list[Block]:
    """State what the runs show, in sentences generated from their numbers, then the numbers."""
    findings: list[Finding] = []
    reasons: list[Block] = []
    doubts: list[Block] = []
    for task in study.tasks:
        tested = tested_findings(task, decided)
        findings += tested
        reasons += [finding.verdict(shown_reasons=1) for finding in tested]
        reasons += query_summary(
            [finding for finding in understood if finding.task is task]
        )
        for verdict in (learning_verdict(task), vision_verdict(task)):
            if verdict:
                (reasons if verdict.tone == "good" else doubts).append(verdict)
    blocks = [answer([*findings, *understood], len(study.tasks)), *doubts]
    if any(task.label for task in study.tasks):
        blocks.append(_results(study))
    if study.problems:
        remarks = f"{counted(len(study.problems), 'remark')} on the run folders"
        sentence = f"Before these numbers are used, read the {remarks}."
        reason = (
            "The page Runs lists what is missing or damaged, and how it was handled."
        )
        blocks.append(Verdict(sentence, [reason], tone="bad"))
    return [*blocks, Folded(title="Reasons, task by task", blocks=reasons)]


def _results(study: StudyData) -> Figure:
    scores: list[float] = []
    rows = []
    agents: list[Evaluated] = []
    abouts: dict[str, str] = {}
    known: set[str] = set()
    for task in study.tasks:
        agents += task.agents
        for agent in task.agents:
            row = row_of(task, agent, *MEASURES, "vision_gain")
            rows.append(row | {"task": task.title})
            known |= {key for key in MEASURES if row[key]}
            scores += agent.scores("success").tolist()
        for group in task.groups:
            if group.agent in AGENTS:
                abouts[group.agent] = f"{group.agent}: {AGENTS[group.agent].about}"
    keys = ["agent", *(key for key in MEASURES if key in known), "vision_gain", "seeds"]
    axes = {"success": near(SUCCESS_AXIS, scores)}
    several = len(study.tasks) > 1
    if several:
        keys.insert(0, "task")
    else:
        axes["return_mean"] = RETURN_AXIS
    panels = []
    for task in study.tasks:
        for key, axis in axes.items():
            dots = [group_dot(task, agent, key) for agent in task.agents]
            name = f"{axis.title} of each agent on {task.title}"
            svg = dot_chart(dots, name, axis, left=124)
            panels.append(Panel(svg, task.title if several else axis.title))
    note = SUMMARY_NOTE.format(
        conditions=conditions(first_evaluation(agents)),
        agents="; ".join(abouts.values()),
    )
    title = "Success, accuracy and return after training"
    sources = [run.path for run in study.runs]
    table = DataTable("summary", title, shared(*keys), rows, sources, note)
    return Figure(table, SUMMARY_CAPTION, panels, open_table=True)
