"""Builds `docs/results/answer.md`, its further pages and CSV files from the packs of the studies.

    python -m scripts.build_answer

Outcomes and comparisons are fixed in the study's file (src/knowarm/study/shipped/answer.toml).
"""

import argparse
import re
import tempfile
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from knowarm.report.collect import collect
from knowarm.study.driver import open_study
from knowarm.study.pack import unpack_study
from knowarm.study.status import study_status
from scripts.answer_a3c import a3c_page
from scripts.answer_cells import (
    SIGNIFICANT,
    Cell,
    agents_table,
    cells_of,
    title_of,
    verdict,
    write_comparisons,
    write_runs,
)
from scripts.answer_changes import write_changes
from scripts.answer_fusions import fusions_section
from scripts.answer_outcomes import (
    Decided,
    anova_section,
    answer,
    cost_section,
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


def faster_cells(cells: Sequence[Cell]) -> list[Cell]:
    """Return the cells in which full knowledge needs fewer steps than the baseline."""
    decided = [(cell, *pair) for cell in cells if (pair := cell.of("full", "bm"))]
    return [cell for cell, c, p in decided if p < SIGNIFICANT and c.steps.high < 0]


def main_page(cells: Sequence[Cell], known: Decided, progress: str) -> list[str]:
    """Return the blocks of the page with the answer.

    Args:
        cells: robots and colours with their agents.
        known: what the reports decide on them.
        progress: how much of the studies is done.
    """
    agents = [agent for cell in cells for agent in cell.agents.values()]
    tasks = [cell.task for cell in cells]
    parts = [
        "# Does semantic knowledge help a robot arm to learn?",
        answer(known, tasks, len(faster_cells(cells)), list(map(title_of, tasks))),
        FIGURE,
        "\n".join(f"- {verdict(cell)}" for cell in cells),
        TOP.format(
            runs=sum(len(agent.seeds) for agent in agents),
            seeds=max(len(agent.seeds) for agent in agents),
            progress=progress,
        ),
    ]
    return [*parts, *outcomes_section(known, cells), *anova_section(tasks), BOTTOM]


def cells_page(cells: Sequence[Cell]) -> list[str]:
    """Return the blocks of the page with a table per cell."""
    count = len(faster_cells(cells)) or "none"
    parts = ["# Every cell and agent", CELLS.format(count=count, cells=len(cells))]
    for cell in cells:
        parts += [f"## {title_of(cell.task)}", agents_table(cell)]
    return [*parts, *cost_section([cell.task for cell in cells])]


HEAD = "<!-- Written by scripts/build_answer.py from the packs; do not edit. -->\n"

CELLS = """**`full` needs fewer steps to 80 % success than `bm` in {count} of {cells} cells.**
Protocol, outcomes and controls: [answer](answer.md); every comparison, with intervals and p:
`answer-comparisons.csv`."""

TOP = """**Protocol.** {runs} runs with `fast`: 1.5 million steps, one process, up to {seeds}
training seeds; studies `answer` (IRB120), `answer-tiago`, and `paper` (TIAGo with randomized
colours, and its `partial` with fixed ones, compared with the `bm` of `paper`). {progress} The
outcomes of `answer` were fixed when seeds 0 to 2 of `bm`, `partial` and `full` were known, those of
`answer-tiago` before its runs. Primary: environment steps until 80 % of the 40 interim episodes
succeed (5 cm, 15 degrees), every 50,000 steps; a run that never does counts as 1.5 million, and as
censored. Secondary: success of 1,000 episodes after training (10 cm, 17 degrees); mean success
during training (*area*). Brackets: 95 % intervals over training seeds (bootstrap of means, too
narrow below about ten seeds; Welch's t for differences). p: log-rank, Holm's correction over a
cell's comparisons. [Every cell and agent](answer-cells.md); `answer-runs.csv`.

An effect of what the knowledge says must exceed that of every
[control](../concepts.md#controls-separate-causes)."""

FIGURE = (
    "![Success of every run of `bm`, `partial` and `full`](../images/reach-success.svg)"
)

BOTTOM = """## What this cannot say

- The vector of this task names what the image shows anyway. Where the graph decides what to do, it
  matters: [choose](choose.md), [answers](answers.md).
- `fast` uses the simulator's state in the critic and an auxiliary loss.
- On TIAGo success has reached its ceiling, so only the steps and the area can differ.

Repeat: `knowarm study run` with the studies named above; pack them; `python -m
scripts.build_answer`."""


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
        # MyST takes a line that begins with % for a comment.
        block = re.sub(r"\s+%", "\0%", block)
        items = [re.sub(r"\s+", " ", item) for item in re.split(r"\n(?=- )", block)]
        indents = ["  " * item.startswith("- ") for item in items]
        filled = [
            textwrap.fill(item, subsequent_indent=indent, **options)
            for item, indent in zip(items, indents, strict=True)
        ]
        lines.append("\n".join(filled))
    return "\n\n".join(lines).replace("\0", " ")


def main() -> None:
    """Unpack the studies; write the page and its CSV files."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=PAGE)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = {
            name: unpack_study(RESULTS / f"{name}.tar.xz", Path(temporary) / name)
            for name in (*STUDIES, "size", "a3c-tuned", "fusions", "choose")
        }
        shares = RESULTS / "fusions.csv", RESULTS / "fusions-blind.csv"
        progress = done(folder["fusions"])
        pages = {
            "-fusions": fusions_section(
                folder["fusions"], folder["choose"], *shares, progress
            )
        }
        studies = [collect([folder[name]]) for name in STUDIES]
        cells = cells_of(studies)
        known = Decided.of(studies, [cell.task for cell in cells])
        states = dict.fromkeys(done(folder[name]) for name in STUDIES)
        progress = " ".join(state for state in states if state != ALL_DONE) or ALL_DONE
        tuned = folder["a3c-tuned"]
        pages["-a3c"] = a3c_page(tuned, done(tuned))
        pages["-size"] = size_section(
            folder["size"], RESULTS / "size-speed.csv", done(folder["size"]), cells
        )
        pages["-cells"] = cells_page(cells)
        pages[""] = main_page(cells, known, progress)
        for end, blocks in pages.items():
            text = HEAD + wrapped("\n\n".join(blocks)) + "\n"
            path = given.out.with_stem(given.out.stem + end)
            path.write_text(text, encoding="utf-8")
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
