"""Page "Runs": the run folders behind the report, and their defects."""

from knowarm.report.blocks import Block, Column, Table, Text, shared
from knowarm.report.study import Run, Study

VERSIONS = ("knowarm", "torch", "mujoco")


def run_blocks(study: Study) -> list[Block]:
    """List every run with its versions and machine, and every defect of a folder."""
    runs = Table(
        name="runs",
        title="Runs",
        columns=[
            *shared("task", "agent", "seed"),
            Column("folder", "folder", "path"),
            Column("commit", "commit"),
            *(Column(name, name) for name in VERSIONS),
            Column("machine", "machine"),
        ],
        rows=[
            {"task": task.title, "agent": group.name, "seed": run.seed, "folder": run.path}
            | _origin(run)
            for task in study.tasks
            for group in task.groups
            for run in group.runs
        ],
        sources=[run.path / "provenance.json" for run in study.runs],
    )
    if not study.problems:
        return [Text(paragraphs=["The folders have no defects."]), runs]
    return [_problems(study), runs]


def _origin(run: Run) -> dict[str, str | None]:
    """Return the commit, the versions and the machine of a run."""
    versions = run.provenance.get("versions", {})
    return {
        "commit": (run.provenance.get("commit") or "")[:10],
        **{name: versions.get(name) for name in VERSIONS},
        "machine": run.provenance.get("machine", {}).get("processor"),
    }


def _problems(study: Study) -> Table:
    return Table(
        name="problems",
        title="Defects of the folders",
        columns=[
            Column("path", "folder or file", "path"),
            Column("what", "found"),
            Column("done", "handled as"),
        ],
        rows=[{"path": p.path, "what": p.what, "done": p.done} for p in study.problems],
    )
