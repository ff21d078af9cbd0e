"""Builds `docs/results/answer.md` from the packs of the studies.

    python -m scripts.build_answer

Outcomes and comparisons are fixed in the study's file (src/knowarm/study/shipped/answer.toml).
"""

import argparse
import re
import tempfile
import textwrap
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from knowarm.report.model import TaskData
from knowarm.report.pages.paper import published_result, time_saved
from knowarm.statistics import Interval
from knowarm.study.driver import open_study
from knowarm.study.pack import unpack_study
from knowarm.study.status import study_status
from scripts.answer_a3c import a3c_section, tuned_section
from scripts.answer_cells import (
    CONTROLS,
    SIGNIFICANT,
    Agent,
    Cell,
    agents_table,
    comparison_table,
    comparisons,
    plus,
    runs_table,
    signed,
    table,
    tasks_of,
    title_of,
    verdict,
)
from scripts.answer_changes import changes_section
from scripts.answer_fusions import fusions_section
from scripts.answer_outcomes import (
    anova_section,
    answer,
    cost_section,
    mean_success_row,
    outcomes_section,
)
from scripts.answer_size import size_section

RESULTS = Path(__file__).parents[1] / "docs" / "results"
PAGE = RESULTS / "answer.md"
STUDIES = ("answer", "answer-tiago", "paper")  # of a cell that two have, the first counts


def saving(task: TaskData, agent: str) -> float | None:
    """Return the share of the baseline's steps that an agent saved in the paper."""
    results = [published_result(task, name) for name in (agent, "bm")]
    if not all(results):
        return None
    return time_saved(*(each["best_step"] for each in results if each))


def spread_of(values: Sequence[float | None], digits: int = 0) -> str:
    """Format the range of numbers in percent."""
    known = [100 * value for value in values if value is not None]
    low, high = (plus(value, digits) for value in (min(known), max(known)))
    return low if low == high else f"{low} to {high}"


def widest(shares: Sequence[Interval]) -> str:
    """Format the range of the intervals of shares that are saved."""
    return " and ".join(
        f"{-100 * each:+.0f}"
        for each in (max(each.high for each in shares), min(each.low for each in shares))
    )


def claims_table(cells: Sequence[Cell], more: Sequence[Sequence[str]]) -> str:
    """Set each claim of the paper beside what these runs say about it; ``more`` rows follow."""
    rows = []
    for name, words in (("full", "Full knowledge"), ("partial", "Partial knowledge")):
        decided = [(cell, *pair) for cell in cells if (pair := cell.of(name, "bm"))]
        faster = [p < SIGNIFICANT and c.steps.high < 0 for _, c, p in decided]
        rows.append(
            [
                f"{words} shortens learning",
                f"{spread_of([saving(cell.task, name) for cell in cells])} % of the steps saved",
                f"{spread_of([-c.share.estimate for _, c, _ in decided])} % saved (intervals "
                f"within {widest([c.share for _, c, _ in decided])} %)",
                judged(faster),
            ]
        )
        gains = [
            one["accuracy"] - other["accuracy"]
            for cell in cells
            if (one := published_result(cell.task, name))
            and (other := published_result(cell.task, "bm"))
        ]
        rows.append(
            [
                f"{words} raises the final score",
                f"{spread_of(gains)} points",
                f"{spread_of([c.success.estimate for _, c, _ in decided], 1)} points",
                judged([c.success.low > 0 for _, c, _ in decided]),
            ]
        )
    rows.append(["It helps more where colours are randomized", *randomized_row(cells)])
    rows.append(["What the knowledge says matters", "no control", *content_row(cells)])
    return table(["claim", "the paper", "here", "verdict"], [*rows, *more])


def faster_cells(cells: Sequence[Cell]) -> list[Cell]:
    """Return the cells in which full knowledge needs fewer steps than the baseline."""
    decided = [(cell, *pair) for cell in cells if (pair := cell.of("full", "bm"))]
    return [cell for cell, c, p in decided if p < SIGNIFICANT and c.steps.high < 0]


def judged(supported: Sequence[bool]) -> str:
    """Return a verdict from the cells that support a claim."""
    count = sum(supported)
    if not supported:
        return "not enough seeds"
    if not count:
        return f"not found in any of {len(supported)} cells"
    return f"found in {count} of {len(supported)} cells"


def randomized_row(cells: Sequence[Cell]) -> tuple[str, str, str]:
    """Compare what full knowledge saves with randomized and with fixed colours."""
    by_robot: dict[str, dict[str, Cell]] = {}
    for cell in cells:
        robot, colours = cell.task.key
        by_robot.setdefault(robot, {})[colours] = cell
    published, found, more = [], [], []
    for pair in by_robot.values():
        if set(pair) != {"fixed", "randomized"}:
            continue
        savings = [saving(pair[colours].task, "full") for colours in ("randomized", "fixed")]
        if None not in savings:
            published.append((savings[0] or 0) - (savings[1] or 0))
        shares = [pair[colours].of("full", "bm") for colours in ("randomized", "fixed")]
        if all(shares):
            one, other = (each[0].share for each in shares if each)
            gain = other.estimate - one.estimate
            half = np.hypot((one.high - one.low) / 2, (other.high - other.low) / 2)
            found.append(gain)
            more.append(bool(gain > half))
    if not found:
        return "", "", judged(more)
    verdict = "found" if all(more) else "found for one robot" if any(more) else "not found"
    here = f"{spread_of(found)} points"
    return f"{spread_of(published)} points more of the steps saved", here, verdict


def content_row(cells: Sequence[Cell]) -> tuple[str, str]:
    """Compare full knowledge with its controls."""
    decided = [pair for cell in cells for name in CONTROLS if (pair := cell.of("full", name))]
    faster = sum(p < SIGNIFICANT and c.steps.high < 0 for c, p in decided)
    if not decided:
        return "", "no control ran"
    shares = spread_of([-c.share.estimate for c, _ in decided])
    count = len(decided)
    verdict = f"faster in {faster} of {count} comparisons" if faster else "not found"
    return f"{shares} % of the controls' steps saved in {count} comparisons", verdict


def paper_table(found: Sequence[tuple[TaskData, Mapping[str, Agent]]]) -> str:
    """Return the paper's figures beside these."""
    rows = []
    for task, agents in found:
        base = published_result(task, "bm")
        for name in ("bm", "partial", "full"):
            paper = published_result(task, name)
            if paper is None or base is None or name not in agents or "bm" not in agents:
                continue
            own = time_saved(agents[name].steps.mean(), agents["bm"].steps.mean())
            its = time_saved(paper["best_step"], base["best_step"])
            best, steps = f"{100 * paper['accuracy']:.0f}", f"{paper['best_step'] / 1e6:.0f} M"
            saved = ["", ""] if name == "bm" else [f"{100 * x:.0f} %" for x in (its or 0, own or 0)]
            mine = agents[name]
            score, reached = f"{100 * mine.success.mean():.1f}", f"{mine.steps.mean() / 1e6:.2f} M"
            rows.append([title_of(task), f"`{name}`", best, score, steps, reached, *saved])
    columns = ["cell", "agent", "paper [%]", "here [%]", "paper: best at", "here: 80 % at"]
    return table([*columns, "paper: saved", "here: saved"], rows)


def page(
    found: Sequence[tuple[TaskData, Mapping[str, Agent]]],
    before: Mapping[tuple[str, str], str],
    progress: str,
    size: Sequence[str],
    sections: Sequence[str],
) -> str:
    """Write the page.

    Args:
        found: cells and their agents.
        before: what older seeds gave, by cell, where other studies trained anew.
        progress: how much of the studies is done.
        size: section on the size of the network.
        sections: what follows the table of all runs.
    """
    runs = sum(len(each.seeds) for _, agents in found for each in agents.values())
    hours = sum(each.hours for _, agents in found for each in agents.values())
    seeds = sorted({seed for _, agents in found for each in agents.values() for seed in each.seeds})
    processors = "; ".join(processors_of([a for _, agents in found for a in agents.values()]))
    has_controls = any(name in agents for _, agents in found for name in CONTROLS)
    cells = [Cell(task, agents, comparisons(agents)) for task, agents in found]
    tasks = [task for task, _ in found]
    parts = [
        HEAD,
        answer(tasks, len(faster_cells(cells)), len(cells)),
        FIGURE,
        claims_table(cells, [mean_success_row(tasks)]),
        "\n".join(f"- {verdict(cell)}" for cell in cells),
        TOP.format(
            runs=runs,
            hours=hours,
            seeds=", ".join(map(str, seeds)),
            progress=progress,
            controls=WITH_CONTROLS if has_controls else WITHOUT_CONTROLS,
        ),
    ]
    parts += outcomes_section(tasks)
    parts.append(f"## The paper's figures beside these\n\n{PAPER}\n\n{paper_table(found)}")
    for cell in cells:
        parts += [f"## {title_of(cell.task)}", agents_table(cell.agents)]
        parts.append(comparison_table(cell.compared))
        parts += [before[cell.task.key]] if cell.task.key in before else []
    parts += [
        *size,
        *anova_section(tasks),
        *cost_section(tasks),
        "## Every run",
        runs_table(cells),
        *sections,
        BOTTOM.format(processors=processors),
    ]
    return wrapped("\n\n".join(parts)) + "\n"


def older(study: Path, anew: Path) -> dict[tuple[str, str], str]:
    """Say by cell what a study gave whose cells another one trained anew."""
    trained = {task.key for task, _ in tasks_of([anew])}
    return {
        task.key: OLDER.format(
            seeds=", ".join(map(str, agents["full"].seeds)),
            differences="; ".join(
                f"`{each.first}` - `{each.second}` {signed(each.steps, 1e-3)} thousand steps "
                f"({signed(each.share, 100)} %)"
                for each in comparisons(agents)
            ),
        )
        for task, agents in tasks_of([study])
        if task.key in trained
    }


def processors_of(agents: Sequence[Agent]) -> list[str]:
    """Say which agents and seeds ran on which processor."""
    used: dict[str, dict[str, set[int]]] = defaultdict(lambda: defaultdict(set))
    counts: Counter[str] = Counter()
    for each in agents:
        for processor, seed in zip(each.processors, each.seeds, strict=True):
            used[processor][each.name].add(seed)
            counts[processor] += 1
    lines = []
    for processor, seeds_of in used.items():
        alike: dict[str, list[str]] = defaultdict(list)
        for name, seeds in sorted(seeds_of.items()):
            alike[", ".join(map(str, sorted(seeds)))].append(f"`{name}`")
        who = "; ".join(f"{', '.join(names)}: seeds {seeds}" for seeds, names in alike.items())
        lines.append(f"{counts[processor]} runs on an {processor} ({who})")
    return lines


HEAD = """<!-- Written by scripts/build_answer.py from the packs; do not edit. -->
# Does semantic knowledge help a robot arm to learn?"""

TOP = """**Protocol.** {runs} runs of the paper's task with `fast` (IRB120 from the study
`answer`, TIAGo from `answer-tiago`, with randomized colours from `paper`), 1.5 million steps, one
process, training seeds {seeds};
{hours:.0f} hours of one core. {progress} The outcomes and
comparisons of `answer` were fixed when the runs of `bm`,
`partial` and `full` with seeds 0 to 2 were known, and before any other run; those of
`answer-tiago`, the same, before any of its runs. Primary: environment
steps until 80 % of the 40 interim episodes succeed (5 cm, 15 degrees); a run that never does counts
as 1.5 million, and as censored in the log-rank test. Secondary: success of 1,000 episodes after
training (10 cm, 17 degrees), and area under the curve of interim success. Brackets: 95 % intervals
over training seeds (bootstrap of means, too narrow below about ten seeds; Welch's t for
differences). p: log-rank, Holm's correction over the comparisons of a cell. *Detectable*: the
difference in thousands of steps that a t test with as many seeds, also corrected, finds in 80 % of
studies.

{controls}"""

WITH_CONTROLS = """Controls: `wide` is a network as large without knowledge, `zeros` a constant
vector, `random` has random numbers in place of each slot, `shuffled` a graph whose tails are
permuted within each relation. An effect of what the knowledge says must exceed all of them."""

WITHOUT_CONTROLS = """**No control is among these runs**, so a difference could not be attributed to
knowledge or to network size. Study `answer` has four: a network as large, zeros, random numbers, a
shuffled graph."""

OLDER = """Older runs of this cell, seeds {seeds} of the study `paper`, raised the question. They
had no controls, other processors and the curriculum of their time, and are not among those above:
{differences}."""

PAPER = """The paper's accuracy counts the distance alone, of one training seed per agent with A3C,
after the step of its best model. Here success counts distance and angle, as means over seeds, with
another algorithm and simulator."""

FIGURE = "![Success of every run of `bm`, `partial` and `full`](../images/reach-success.svg)"

BOTTOM = """## What this cannot say

- The vector of this task is constant within an episode and names what the image shows anyway. It
  can save the network the recognition of the object, nothing else. Where a graph decides what to
  do, it changes everything: see [choose](choose.md) and [answers](answers.md).
- `fast` learns from the simulator's state in the critic and an auxiliary loss. Settings with which
  A3C learns are on [its own page](a3c.md).
- Processors: {processors}, of several generations ([lab notes](../lab-notes.md)). Another kind
  rounds differently, so the same seed is another training there.
- Interim evaluations stand 50,000 steps apart, so no smaller difference is seen in one run.
- On TIAGo success has reached its ceiling, so only the steps and the mean success during training
  can differ. With randomized colours its runs have no controls.

The report of the twelve cells is `paper.html`. The policies `zoo/irb120-full-fast` and
`zoo/tiago-full-fast` are seeds 0: `knowarm evaluate zoo/irb120-full-fast` prints 99.6 % [99.0,
99.8], `zoo/tiago-full-fast` 99.9 % [99.4, 100.0].

Repeat: `knowarm study run` with `answer`, `answer-tiago`, `paper`, `size`, `a3c`, `a3c-tuned`,
`fusions` and `choose`, and `python -m benchmarks.a3c_changes` with `add --steps 2000000`,
`leave-out --steps 5000000 --seeds 0` and `set`; pack them, then `python -m
scripts.build_answer`."""


def wrapped(text: str) -> str:
    """Wrap paragraphs and list items, not tables and comments, at 120 columns."""
    options: dict[str, Any] = {"width": 120, "break_long_words": False, "break_on_hyphens": False}
    lines: list[str] = []
    for block in text.split("\n\n"):
        if block.startswith(("|", "<!--", "#")):
            lines.append(block)
            continue
        items = [re.sub(r"\s+", " ", item) for item in re.split(r"\n(?=- )", block)]
        indents = ["  " * item.startswith("- ") for item in items]
        filled = [
            textwrap.fill(item, subsequent_indent=indent, **options)
            for item, indent in zip(items, indents, strict=True)
        ]
        lines.append("\n".join(filled))
    return "\n\n".join(lines)


def main() -> None:
    """Unpack the studies and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=PAGE)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = {
            name: unpack_study(RESULTS / f"{name}.tar.xz", Path(temporary) / name)
            for name in (*STUDIES, "size", "a3c", "a3c-tuned", "fusions", "choose")
        }
        shares = RESULTS / "fusions.csv", RESULTS / "fusions-blind.csv"
        progress = done(folder["fusions"])
        fusions = fusions_section(folder["fusions"], folder["choose"], *shares, progress)
        cells = list(tasks_of([folder[name] for name in STUDIES]))
        before = older(folder["paper"], folder["answer-tiago"])
        progress = " ".join(done(folder[name]) for name in STUDIES)
        a3c = a3c_section(folder["a3c"], done(folder["a3c"]))
        tuned = tuned_section(folder["a3c-tuned"], done(folder["a3c-tuned"]))
        changes = changes_section(RESULTS / "a3c-changes")
        size = size_section(folder["size"], RESULTS / "size-speed.csv", done(folder["size"]))
        text = page(cells, before, progress, size, [*a3c, *tuned, *changes, *fusions])
        given.out.write_text(text, encoding="utf-8")


def done(folder: Path) -> str:
    """Say how many runs of a study are done, and which failed."""
    study = open_study(folder)
    runs = study_status(study, folder)
    count = sum(run.state == "done" for run in runs)
    failed = ", ".join(f"`{run.name}` ({run.detail})" for run in runs if run.state == "failed")
    failures = f"failed: {failed}" if failed else "none failed"
    if count == len(runs):
        every = "Both" if count == 2 else f"All {count}"
        return f"{every} runs of the study `{study.name}` are done."
    return f"Of the study `{study.name}` {count} of {len(runs)} runs are done; {failures}."


if __name__ == "__main__":
    main()
