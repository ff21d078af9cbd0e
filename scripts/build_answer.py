"""Builds `docs/results/answer.md` and its CSV files from the packs of the studies.

    python -m scripts.build_answer

Outcomes and comparisons are fixed in the study's file (src/knowarm/study/shipped/answer.toml).
"""

import argparse
import re
import tempfile
import textwrap
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
    comparisons,
    plus,
    table,
    tasks_of,
    title_of,
    verdict,
    write_comparisons,
    write_runs,
)
from scripts.answer_changes import changes_section, write_changes
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
CHANGES = RESULTS / "a3c-changes"
ALL_DONE = "None failed."
"""What the page says of a study whose runs are all done."""
# Of a cell that two have, the first counts
STUDIES = (
    "answer",
    "answer-tiago",
    "paper",
)


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
        for each in (
            max(each.high for each in shares),
            min(each.low for each in shares),
        )
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
        savings = [
            saving(pair[colours].task, "full") for colours in ("randomized", "fixed")
        ]
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
    verdict = (
        "found" if all(more) else "found for one robot" if any(more) else "not found"
    )
    here = f"{spread_of(found)} points"
    return f"{spread_of(published)} points more of the steps saved", here, verdict


def content_row(cells: Sequence[Cell]) -> tuple[str, str]:
    """Compare full knowledge with its controls."""
    decided = [
        pair for cell in cells for name in CONTROLS if (pair := cell.of("full", name))
    ]
    faster = sum(p < SIGNIFICANT and c.steps.high < 0 for c, p in decided)
    if not decided:
        return "", "no control ran"
    shares = spread_of([-c.share.estimate for c, _ in decided])
    count = len(decided)
    verdict = f"faster in {faster} of {count} comparisons" if faster else "not found"
    return f"{shares} % of the controls' steps saved in {count} comparisons", verdict


def paper_table(found: Sequence[tuple[TaskData, Mapping[str, Agent]]]) -> str:
    """Return the paper's figures beside these, one row per cell."""
    rows = []
    for task, agents in found:
        paper = {
            name: published_result(task, name) for name in ("bm", "partial", "full")
        }
        base = paper["bm"]
        if base is None or "bm" not in agents:
            continue
        known = {name: each for name, each in paper.items() if each and name in agents}
        better = [name for name in paper if name in known and name != "bm"]
        its = [
            time_saved(known[name]["best_step"], base["best_step"]) for name in better
        ]
        own = [
            time_saved(agents[n].steps.mean(), agents["bm"].steps.mean())
            for n in better
        ]
        rows.append(
            [
                title_of(task),
                ", ".join(f"`{name}`" for name in known),
                ", ".join(f"{100 * each['accuracy']:.0f}" for each in known.values()),
                ", ".join(f"{each['best_step'] / 1e6:.0f}" for each in known.values()),
                *(
                    ", ".join(f"{100 * (x or 0):.0f}" for x in values)
                    for values in (its, own)
                ),
            ]
        )
    columns = [
        *("cell", "agents", "paper's accuracy [%]", "best at [M steps]"),
        *("steps saved against `bm` [%]", "here: saved [%]"),
    ]
    return table(columns, rows)


def page(
    cells: Sequence[Cell], progress: str, size: Sequence[str], sections: Sequence[str]
) -> str:
    """Write the page.

    Args:
        cells: robots and colours with their agents.
        progress: how much of the studies is done.
        size: section on the size of the network.
        sections: what follows the cost of training.
    """
    found = [(cell.task, cell.agents) for cell in cells]
    runs = sum(len(each.seeds) for _, agents in found for each in agents.values())
    seeds = sorted(
        {seed for _, agents in found for each in agents.values() for seed in each.seeds}
    )
    has_controls = any(name in agents for _, agents in found for name in CONTROLS)
    tasks = [task for task, _ in found]
    parts = [
        HEAD,
        answer(tasks, len(faster_cells(cells)), len(cells)),
        FIGURE,
        claims_table(cells, [mean_success_row(tasks)]),
        "\n".join(f"- {verdict(cell)}" for cell in cells),
        TOP.format(
            runs=runs,
            seeds=", ".join(map(str, seeds)),
            progress=progress,
            controls=WITH_CONTROLS if has_controls else WITHOUT_CONTROLS,
        ),
    ]
    parts += outcomes_section(tasks)
    parts.append(
        f"## The paper's figures beside these\n\n{PAPER}\n\n{paper_table(found)}"
    )
    for cell in cells:
        parts += [f"## {title_of(cell.task)}", agents_table(cell)]
    parts += [
        *size,
        *anova_section(tasks),
        *cost_section(tasks),
        *sections,
        BOTTOM,
    ]
    return wrapped("\n\n".join(parts)) + "\n"


HEAD = """<!-- Written by scripts/build_answer.py from the packs; do not edit. -->
# Does semantic knowledge help a robot arm to learn?"""

TOP = """**Protocol.** {runs} runs with `fast`: 1.5 million steps, one process, training seeds
{seeds}; studies `answer` (IRB120), `answer-tiago` and, for TIAGo with randomized colours, `paper`.
{progress} The outcomes of `answer` were fixed when seeds 0 to 2 of `bm`, `partial` and `full` were
known, those of `answer-tiago` before its runs. Primary: environment steps until 80 % of the 40
interim episodes succeed (5 cm, 15 degrees); a run that never does counts as 1.5 million, and as
censored in the log-rank test. Secondary: success of 1,000 episodes after training (10 cm, 17
degrees); *area*, the mean success during training. Brackets: 95 % intervals over training seeds
(bootstrap of means, too narrow below about ten seeds; Welch's t for differences). p: log-rank,
Holm's correction over the comparisons of a cell. Every run: `answer-runs.csv`; every comparison,
also of `partial` with `bm`: `answer-comparisons.csv`.

{controls}"""

WITH_CONTROLS = """Controls: `wide` is a network as large without knowledge, `zeros` a constant
vector, `random` has random numbers in place of each slot, `shuffled` a graph whose tails are
permuted within each relation. An effect of what the knowledge says must exceed all of them."""

WITHOUT_CONTROLS = """**No control is among these runs**, so a difference could not be attributed to
knowledge or to network size."""

PAPER = """The paper's accuracy counts the distance alone, of the best model of one A3C training per
agent; here success counts distance and angle, as a mean over seeds."""

FIGURE = (
    "![Success of every run of `bm`, `partial` and `full`](../images/reach-success.svg)"
)

BOTTOM = """## What this cannot say

- The vector of this task names what the image shows anyway. Where the graph decides what to do, it
  matters: [choose](choose.md), [answers](answers.md).
- `fast` uses the simulator's state in the critic and an auxiliary loss.
- The runs used several kinds of processors, which round differently.
- Interim evaluations are 50,000 steps apart: smaller differences are not seen in one run.
- On TIAGo success has reached its ceiling, so only the steps and the area can differ.

Repeat: `knowarm study run` with the studies named above, and `python -m benchmarks.a3c_changes`
with `add --steps 2000000`, `leave-out --steps 5000000 --seeds 0` and `set`; pack them, then `python
-m scripts.build_answer`. Seeds 0 are `zoo/irb120-full-fast` and `zoo/tiago-full-fast`."""


def wrapped(text: str) -> str:
    """Wrap paragraphs and list items, not tables and comments, at 120 columns."""
    options: dict[str, Any] = {
        "width": 120,
        "break_long_words": False,
        "break_on_hyphens": False,
    }
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
    """Unpack the studies; write the page and its CSV files."""
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
        fusions = fusions_section(
            folder["fusions"], folder["choose"], *shares, progress
        )
        found = tasks_of([folder[name] for name in STUDIES])
        cells = [Cell(task, agents, comparisons(agents)) for task, agents in found]
        states = dict.fromkeys(done(folder[name]) for name in STUDIES)
        progress = " ".join(state for state in states if state != ALL_DONE) or ALL_DONE
        a3c = a3c_section(folder["a3c"], done(folder["a3c"]))
        tuned = tuned_section(folder["a3c-tuned"], done(folder["a3c-tuned"]))
        changes = changes_section(CHANGES)
        size = size_section(
            folder["size"], RESULTS / "size-speed.csv", done(folder["size"])
        )
        text = page(cells, progress, size, [*a3c, *tuned, *changes, *fusions])
        given.out.write_text(text, encoding="utf-8")
        write_runs(cells, given.out.with_name("answer-runs.csv"))
        write_comparisons(cells, given.out.with_name("answer-comparisons.csv"))
        write_changes(CHANGES, given.out.with_name("a3c-changes.csv"))


def done(folder: Path) -> str:
    """Say that no run of a study failed, or how many are done and which failed."""
    study = open_study(folder)
    runs = study_status(study, folder)
    count = sum(run.state == "done" for run in runs)
    failed = ", ".join(
        f"`{run.name}` ({run.detail})" for run in runs if run.state == "failed"
    )
    failures = f"failed: {failed}" if failed else "none failed"
    if count == len(runs):
        return ALL_DONE
    return (
        f"Of the study `{study.name}` {count} of {len(runs)} runs are done; {failures}."
    )


if __name__ == "__main__":
    main()
