"""Runs of one task go in; which knowledge they got, and what kind of input it is, come out."""

from collections.abc import Mapping, Sequence

from knowarm.report.blocks import Column, Row, Table, Verdict
from knowarm.report.pages.inputs.told import told
from knowarm.report.study import Run, Task


def constants(task: Task, shown: Sequence[tuple[str, Run]]) -> Verdict:
    """Say which agents get a constant input, and which get privileged numbers."""
    constant = [name for name, run in shown if told(run).get("constant")]
    privileged = [name for name, run in shown if told(run).get("privileged")]
    reasons = []
    if constant:
        reasons.append(
            f"{', '.join(constant)}: every episode gets the same numbers. To the network such an "
            "input is a bias with its own learning rate and extra capacity; it cannot tell one "
            "episode from another. Compare with zeros and wide."
        )
    if privileged:
        reasons.append(
            f"{', '.join(privileged)}: the numbers name the object of the episode, which no camera "
            "told the agent. Compare with a one-hot of the same facts."
        )
    if not reasons:
        return Verdict(sentence=f"{task.title}: no agent was given a knowledge vector.")
    if constant and not privileged:
        sentence = f"{task.title}: the knowledge is a constant input, which is a bias."
    else:
        sentence = f"{task.title}: what kind of input the knowledge is."
    return Verdict(sentence=sentence, reasons=reasons, tone="open")


def overview(task: Task, shown: Sequence[tuple[str, Run]]) -> Table:
    """One row an agent: where its vector comes from, its size and its norm."""
    rows: list[Row] = []
    for name, run in shown:
        known = told(run)
        coverage = known.get("coverage")
        share = coverage.get("share") if isinstance(coverage, Mapping) else coverage
        rows.append(
            {
                "agent": name,
                "source": (known.get("config") or {}).get("source") if known.get("slots") else None,
                "slots": len(known.get("slots") or []),
                "numbers": known.get("dim", 0) or 0,
                "norm": known.get("norm"),
                "coverage": share if known.get("slots") else None,
                "constant": bool(known.get("constant")),
                "privileged": bool(known.get("privileged")),
                "note": known.get("note") or "",
            }
        )
    return Table(
        name=f"knowledge-{task.name}",
        title=f"Knowledge vectors: {task.title}",
        columns=[
            Column(key="agent", label="agent"),
            Column(key="source", label="vectors from"),
            Column(key="slots", label="slots", format="integer"),
            Column(key="numbers", label="numbers", format="integer"),
            Column(key="norm", label="norm", format="number"),
            Column(key="coverage", label="words known", format="percent"),
            Column(key="constant", label="constant"),
            Column(key="privileged", label="privileged"),
            Column(key="note", label="note"),
        ],
        rows=rows,
        sources=[run.path / "provenance.json" for _, run in shown],
    )
