"""Run folders go in; the page that says where every number came from comes out."""

from knowarm.report.blocks import Column, Page, Row, Table, Text
from knowarm.report.study import Study


def runs_page(study: Study) -> Page:
    """Every run with its versions and machine, and everything that was wrong."""
    rows: list[Row] = []
    for task in study.tasks:
        for group in task.groups:
            for run in group.runs:
                versions = run.provenance.get("versions", {})
                machine = run.provenance.get("machine", {})
                rows.append(
                    {
                        "task": task.title,
                        "agent": group.name,
                        "seed": run.seed,
                        "folder": run.path,
                        "commit": (run.provenance.get("commit") or "")[:10],
                        "knowarm": versions.get("knowarm"),
                        "torch": versions.get("torch"),
                        "mujoco": versions.get("mujoco"),
                        "machine": machine.get("processor"),
                    }
                )
    page = Page(
        name="runs",
        short="Runs",
        title="Runs and sources",
        lead="Every number of this report is computed from these folders.",
    )
    if study.problems:
        page.blocks.append(
            Table(
                name="problems",
                title="What was wrong, and what was done about it",
                columns=[
                    Column(key="path", label="folder or file", format="path"),
                    Column(key="what", label="what was found"),
                    Column(key="done", label="what was done"),
                ],
                rows=[
                    {"path": each.path, "what": each.what, "done": each.done}
                    for each in study.problems
                ],
            )
        )
    else:
        page.blocks.append(Text(paragraphs=["Nothing was wrong with the folders."]))
    page.blocks.append(
        Table(
            name="runs",
            title="Runs",
            columns=[
                Column(key="task", label="task"),
                Column(key="agent", label="agent"),
                Column(key="seed", label="seed", format="integer"),
                Column(key="folder", label="folder", format="path"),
                Column(key="commit", label="commit"),
                Column(key="knowarm", label="knowarm"),
                Column(key="torch", label="torch"),
                Column(key="mujoco", label="mujoco"),
                Column(key="machine", label="machine"),
            ],
            rows=rows,
            sources=[run.path / "provenance.json" for run in study.runs],
        )
    )
    return page
