"""All declared outcomes, the paper's analysis of variance, and the cost of training.

Decisions are those of the report (`knowarm.report.verdicts`), so page and report cannot differ.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from knowarm.experiment.csv_log import training_clock
from knowarm.report.format import p_value
from knowarm.report.model import Group, RunData, StudyData, TaskData
from knowarm.report.pages.paper import published_comparison, published_result
from knowarm.report.verdicts.claims import KINDS, OUTCOMES, Claim, Finding, claims
from knowarm.report.verdicts.knowledge import findings
from knowarm.statistics import first_crossing, one_way_anova, welch
from scripts.answer_cells import (
    CONTROLS,
    LEVEL,
    SIGNIFICANT,
    Cell,
    signed,
    table,
    title_of,
)

BATCHES = 10
"""Evaluation seeds that the analysis of variance makes of the 1,000 episodes of a run."""

OUTCOMES_TEXT = """Secondary outcomes; p: Holm's correction over the outcomes of a study, as in its
report. Controls count only where `full` passes ([decisions](../decisions.md#evidence))."""

ANOVA_TEXT = """The paper reads F values of two networks, one training seed each, as an effect of
the knowledge. Here F compares ten times 100 episodes of two runs. The values are not alike, since
the paper's have 30 times 100 episodes, at 60 to 90 % in place of nearly 100."""

COST_TEXT = """Runs on the processor that most runs of a cell share: median steps per second; mean
seconds to 80 % (of the whole training where never reached)."""


@dataclass(frozen=True)
class Decided:
    """What the reports of the studies decide on the cells of the page."""

    claims: Sequence[Claim]
    findings: Mapping[tuple[str, str, str], Finding]
    """By cell, agent and outcome."""

    @classmethod
    def of(cls, studies: Sequence[StudyData], tasks: Sequence[TaskData]) -> "Decided":
        """Decide on each study by itself, as its report does; keep what is said of ``tasks``."""
        kept: list[Claim] = []
        keys = {}
        for study in studies:
            known = claims(study)
            kept += [claim for claim in known if claim.task in tasks]
            for task, outcome in product(study.tasks, OUTCOMES):
                for finding in findings(task, known, outcome):
                    if task in tasks and finding.subject:
                        keys[title_of(task), finding.subject.name, outcome] = finding
        return cls(kept, keys)


def gate_of(finding: Finding) -> Claim:
    """Return the comparison of a finding's agent with the baseline."""
    return next(claim for claim in finding.claims if claim.stage == "gate")


def points(claim: Claim) -> str:
    """Format the difference of a claim."""
    return signed(claim.comparison.difference, 100, 1) if claim.comparison else ""


def mean_success_row(known: Decided) -> list[str]:
    """Return the row of the claims' table on mean success during training."""
    full = [
        each
        for (_, name, outcome), each in known.findings.items()
        if (name, outcome) == FULL_SPEED
    ]
    gates = [gate_of(each) for each in full]
    gains = [
        100 * each.comparison.difference.estimate for each in gates if each.comparison
    ]
    better = [each for each in full if gate_of(each).verdict == "better"]
    verdict = f"found in {len(better)} of {len(full)} cells" if better else "not found"
    if any(each.kind == "size may explain it" for each in better):
        verdict += ", not beyond networks as large"
    spread = f"{min(gains):+.1f} to {max(gains):+.1f} points of mean success"
    return ["Its transitory regime is faster (6)", "no figure", spread, verdict]


FULL_SPEED = ("full", "speed")
"""Agent and outcome of `mean_success_row`."""


def above_baseline(known: Decided, title: str, outcome: str) -> dict[str, Claim]:
    """Return the comparisons of a cell's agents with its baseline, by agent."""
    return {
        claim.first.name: claim
        for claim in known.claims
        if title_of(claim.task) == title
        and claim.outcome == outcome
        and claim.second is claim.task.baseline
    }


def untested(cells: Sequence[Cell]) -> str:
    """Return where `partial`, which no report tests, gains most in mean success."""
    gains = {}
    for cell in cells:
        for compared in cell.compared:
            if compared.first == "partial":
                gains[title_of(cell.task)] = compared.area
    most = max(gains, key=lambda title: gains[title].estimate)
    return (
        "No report tests `partial`. Its mean success during training gains most on "
        f"{most}: {signed(gains[most], 100, 1)} points, not corrected; others: "
        "`answer-comparisons.csv`."
    )


def outcomes_section(known: Decided, cells: Sequence[Cell]) -> list[str]:
    """Return the section with all outcomes that the reports test, and one that none tests."""
    rows = []
    for (title, name, outcome), finding in known.findings.items():
        gate = gate_of(finding)
        rows.append(
            [
                title,
                f"`{name}`",
                OUTCOMES[outcome],
                points(gate),
                p_value(gate.adjusted_p),
                KINDS[finding.kind]["words"],
            ]
        )
    columns = ["cell", "agent", "outcome", "against `bm` [points]", "p", "finding"]
    return ["## All outcomes", OUTCOMES_TEXT, table(columns, rows), untested(cells)]


def answer(
    known: Decided, tasks: Sequence[TaskData], faster: int, cells: Sequence[str]
) -> str:
    """Return the answer of the page; ``faster`` of the cells need fewer steps to 80 %."""
    full = {key: each for key, each in known.findings.items() if key[1] == "full"}
    better = {
        key: each for key, each in full.items() if gate_of(each).verdict == "better"
    }
    after = [key for key in better if key[2] == "success"]
    assert not after
    assert not faster, "write the answer for what is found"
    text = (
        "**No effect of full knowledge on the steps to 80 % success, nor on the success after "
        f"training, is found in any of {len(cells)} cells.**"
    )
    for (title, name, outcome), finding in better.items():
        assert finding.kind == "size may explain it", (
            "write the answer for what is found"
        )
        others = above_baseline(known, title, outcome)
        compared = [others[name].comparison for name in CONTROLS if name in others]
        gains = [100 * each.difference.estimate for each in compared if each]
        text += (
            f" In {OUTCOMES[outcome]}, `{name}` is better than the paper's baseline on "
            f"{title} ({points(gate_of(finding))} points, adjusted p "
            f"{p_value(gate_of(finding).adjusted_p)}), but not than networks as large without "
            f"this knowledge, which gain {min(gains):+.1f} to {max(gains):+.1f} points: the [size "
            "of the network](answer-size.md) is a possible cause."
        )
    low, high = slower(tasks)
    return (
        f"{text} `full` trains at {low} to {high} % of the baseline's steps per second "
        "([cost](answer-cells.md#cost-of-training))."
    )


def slower(tasks: Sequence[TaskData]) -> tuple[str, str]:
    """Return the least and the largest speed of `full` in percent of the baseline's."""
    shares = []
    for task in tasks:
        groups = {group.name: group for group in task.groups}
        one, base = (
            np.array([*costs(groups[n], processor_of(task))]) for n in ("full", "bm")
        )
        shares.append(float(np.median(one[:, 0]) / np.median(base[:, 0])))
    assert max(shares) < 1
    return f"{100 * min(shares):.0f}", f"{100 * max(shares):.0f}"


def processor_of(task: TaskData) -> str:
    """Return the processor of most runs of `bm` and `full`."""
    used = Counter(
        str(run.provenance.machine["processor"])
        for group in task.groups
        if group.name in ("bm", "full")
        for run in group.runs
    )
    return used.most_common(1)[0][0]


def rates(run: RunData, label: str) -> np.ndarray:
    """Return the success in each tenth of the episodes of an evaluation, (BATCHES,)."""
    success = run.evaluations[label].episodes()["success"]
    return np.asarray(success, np.float64).reshape(BATCHES, -1).mean(axis=1)


def anova_section(tasks: Sequence[TaskData]) -> list[str]:
    """Return the section with F values between agents, and between seeds of one agent."""
    rows, own = [], list[tuple[float, float]]()
    for task in tasks:
        by_agent = {
            group.name: [rates(run, group.label) for run in group.runs]
            for group in task.groups
        }
        own_here = [
            one_way_anova(pair)
            for each in by_agent.values()
            for pair in combinations(each, 2)
        ]
        own += own_here
        pairs = list(product(by_agent["full"], by_agent["bm"]))
        between = [one_way_anova(pair) for pair in pairs]
        signs = [bool(one.mean() > other.mean()) for one, other in pairs]
        wins = [
            sum(
                p < SIGNIFICANT and s is sign
                for (_, p), s in zip(between, signs, strict=True)
            )
            for sign in (True, False)
        ]
        groups = {group.name: group for group in task.groups}
        paper = published_comparison(task, groups["full"], groups["bm"])["anova_f"]
        rows.append(
            [
                title_of(task),
                f"{paper:.1f}",
                *spread(between)[:2],
                f"{wins[0]} and {wins[1]} of {len(pairs)}",
                *spread(own_here)[:2],
                share(own_here),
            ]
        )
    columns = [
        *("cell", "paper: F of `full` and `bm`", "here: median F", "95 %"),
        *(
            "p < .05 for `full`, for `bm`",
            "seeds of one agent: median F",
            "95 %",
            "p < .05",
        ),
    ]
    largest = max(f for f, _ in own if np.isfinite(f))
    text = (
        f"**Two training seeds of one and the same agent differ by up to {seeds_apart(tasks):.1f} "
        f"points of success, the paper's agents by {effects(tasks)}.** Of {len(own)} such pairs "
        f"{share(own)} differ with p < .05 (median F {spread(own)[0]}, the largest {largest:.0f})."
    )
    return [
        "## The paper's analysis of variance",
        ANOVA_TEXT,
        table(columns, rows),
        text,
    ]


def seeds_apart(tasks: Sequence[TaskData]) -> float:
    """Return the largest difference of success of two training seeds of one agent [points]."""
    groups = [group for task in tasks for group in task.groups]
    return max(100 * float(np.ptp(group.scores("success"))) for group in groups)


def effects(tasks: Sequence[TaskData]) -> str:
    """Return the range of the paper's differences of `full` and `bm` in accuracy."""
    gains = []
    for task in tasks:
        full, base = (published_result(task, name) for name in ("full", "bm"))
        if full and base:
            gains.append(100 * (full["accuracy"] - base["accuracy"]))
    return f"{min(gains):.0f} to {max(gains):.0f}"


def published_f(tasks: Sequence[TaskData]) -> str:
    """Return the range of the paper's F values."""
    values = []
    for task in tasks:
        groups = {group.name: group for group in task.groups}
        paper = published_comparison(task, groups["full"], groups["bm"])
        values.append(paper["anova_f"])
    return f"{min(values):.0f} to {max(values):.0f}"


def spread(found: Sequence[tuple[float, float]]) -> list[str]:
    """Format median, 95th percentile and largest of F values; without variance F is infinite."""
    values = np.array([f for f, _ in found])
    ends = np.quantile(values, [0.5, 0.95, 1.0], method="lower")
    return ["infinite" if np.isinf(each) else f"{each:.1f}" for each in ends]


def share(found: Sequence[tuple[float, float]]) -> str:
    """Format the share of significant pairs."""
    return f"{100 * np.mean([p < SIGNIFICANT for _, p in found]):.0f} %"


def seconds_to(run: RunData, step: float) -> float:
    """Return the wall time of a training until a step [s]."""
    passed = training_clock(run.metrics["wall_time_s"])
    return float(np.interp(step, run.metrics["step"], passed))


def costs(group: Group, processor: str) -> Iterator[tuple[float, float]]:
    """Yield steps per second, and seconds to 80 %, of the runs on a processor."""
    for run in group.runs:
        if run.provenance.machine["processor"] == processor and run.metrics:
            until = float(run.config.total_steps)
            step, _ = first_crossing(run.interim["step"], run.interim["success"], LEVEL)
            yield until / seconds_to(run, until), seconds_to(run, min(step, until))


def cost(runs: np.ndarray) -> str:
    """Format what `costs` yields of some runs, (n, 2)."""
    return f"{np.median(runs[:, 0]):,.0f}; {runs[:, 1].mean():,.0f}"


def cost_section(tasks: Sequence[TaskData]) -> list[str]:
    """Return the section on steps per second and seconds to 80 %."""
    rows = []
    for task in tasks:
        groups = {group.name: group for group in task.groups}
        processor = processor_of(task)
        base = np.array([*costs(groups["bm"], processor)])
        full = np.array([*costs(groups["full"], processor)])
        later = signed(welch(full[:, 1], base[:, 1]).difference, 1)
        rows.append([title_of(task), cost(base), cost(full), later])
    columns = ["cell", "`bm`", "`full`", "later by [s]"]
    return ["## Cost of training", COST_TEXT, table(columns, rows)]
