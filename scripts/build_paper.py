"""Builds `docs/results/paper.md`, the paper's experiment, and its figures from the study's pack.

    python -m scripts.build_paper

The study is `paper-a3c` (src/knowarm/study/shipped/paper-a3c.toml).
"""

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from knowarm.experiment.summary import read_film
from knowarm.report.blocks import Figure
from knowarm.report.charts import BOXES, RETURN_AXIS, Box
from knowarm.report.collect import collect
from knowarm.report.model import Evaluation, Group, RunData, TaskData
from knowarm.report.pages.behaviour import joint_blocks
from knowarm.report.pages.differences import success_rates
from knowarm.report.pages.paper import published_comparison, published_result
from knowarm.report.pages.training import curve_figure
from knowarm.statistics import Interval, one_way_anova, share_difference
from knowarm.study.driver import open_study
from knowarm.study.pack import unpack_study
from knowarm.study.status import study_status
from scripts.answer_cells import signed, table, title_of
from scripts.build_answer import wrapped
from scripts.figures import picture

ROOT = Path(__file__).parents[1]
PACK = ROOT / "docs" / "results" / "paper-a3c.tar.xz"
JOINTS_BOX = Box(width=320, height=190, left=40, top=26)
FRAMES, SIDE = 8, 96
"""Images of a film strip, and their size [px]."""

HEAD = """<!-- Written by scripts/build_paper.py from the pack; do not edit. -->
# The paper, reproduced"""

PROTOCOL = """**Protocol.** `knowarm study run paper-a3c`: A3C with the paper's numbers, 17
workers of one environment, {steps} million steps, [near start](../reference/world.md#near-start),
one training seed per cell, as in the paper. The best model is that with the highest mean return
of the interim evaluations (40 episodes every 50,000 steps); it plays 1,000 new episodes within 10
cm and 17 degrees. Accuracy counts the distance alone, as the paper's (equation 8), success the
angle, too. *Blind*: success of the best fixed list of actions, which sees nothing. {state}"""

OUTCOMES = {
    "accuracy at 10 cm": ("post-training-greedy", "accuracy", "distance"),
    "success at 10 cm and 17 degrees": (
        "post-training-greedy",
        "success",
        "post-training-greedy",
    ),
    "success at 5 cm and 15 degrees": ("strict", "success", "strict"),
}
"""Outcomes that the study declares before its first run, the primary one first: evaluation and rate
of the best model, and the evaluation whose thresholds its fixed list of actions is searched for.
Within 10 cm at any angle an episode of that list ends, so its success is its accuracy."""

OUTCOMES_TEXT = """Declared before the first run, in the study: the primary outcome is the accuracy
at 10 cm of the best model, minus that of the best fixed list of actions, on the same 1,000 new
episodes; the two rates of success stand beside it. The step of the best model is no outcome: it
is the place of the largest of 1,400 evaluations of 40 episodes. Differences with intervals over
episodes; a training seed is one network."""

ANOVA = """30 evaluation seeds of 100 episodes of each network, success, as the paper's. F compares
two trained networks. It cannot tell the knowledge from the training seed: two seeds of one and the
same agent [give F values as large](answer.md#the-papers-analysis-of-variance)."""

JOINTS = """Angles of all steps of the 1,000 episodes [rad], `full` against `bm`; *change* is the
difference of the standard deviations. One network per agent."""


def of(task: TaskData, agent: str) -> Group | None:
    """Return the group of an agent that was evaluated."""
    return next(
        (each for each in task.groups if each.agent == agent and each.best), None
    )


def percent(value: float) -> str:
    """Format a share."""
    return f"{100 * value:.1f}"


def cells_table(tasks: Sequence[TaskData]) -> str:
    """Return accuracy, success and step of the best model beside the paper's."""
    rows = []
    for task in tasks:
        for group in task.groups:
            paper, run = published_result(task, group.agent), group.best_run
            if paper is None or run is None:
                continue
            numbers = run.evaluations[group.label].summary
            blind = numbers.interval("success", "blind", "open-loop").estimate
            rows.append(
                [
                    title_of(task),
                    f"`{group.name}`",
                    f"{100 * paper['accuracy']:.0f}",
                    percent(numbers["accuracy"]),
                    percent(numbers["success"]),
                    percent(blind),
                    f"{paper['best_step'] / 1e6:.0f} M",
                    f"{(run.best_step or 0) / 1e6:.1f} M",
                ]
            )
    columns = ["cell", "agent", "paper: accuracy", "accuracy", "success", "blind"]
    return table([*columns, "paper: best model at", "best model at"], rows)


def outcomes_table(tasks: Sequence[TaskData]) -> str:
    """Return the declared outcomes of every run that has all of their evaluations."""
    rows = []
    for task in tasks:
        for group in task.groups:
            for run in group.runs:
                needed = {
                    label
                    for own, _, listed in OUTCOMES.values()
                    for label in (own, listed)
                }
                if not needed <= {*run.evaluations}:
                    continue
                cells = [
                    signed(margin(run, *outcome), 100, 1)
                    for outcome in OUTCOMES.values()
                ]
                steps = f"{run.steps_done / 1e6:.1f} M"
                if run.steps_done < run.config.total_steps:
                    steps += ", begun"
                rows.append(
                    [
                        title_of(task),
                        f"`{group.name}`",
                        str(run.config.seed),
                        *cells,
                        steps,
                    ]
                )
    return table(["cell", "agent", "seed", *OUTCOMES, "steps"], rows)


def margin(run: RunData, label: str, measure: str, of_list: str) -> Interval:
    """Return a rate of the best model minus the success of the best fixed list of actions."""
    rate = run.evaluations[label].summary.interval(measure)
    listed = run.evaluations[of_list].summary.interval("success", "blind", "open-loop")
    return share_difference(rate, listed)


def sentences(tasks: Sequence[TaskData]) -> str:
    """Say of each sentence of the paper in how many cells it holds here."""
    pairs = [
        (task, full, bm)
        for task in tasks
        if (full := of(task, "full")) and (bm := of(task, "bm"))
    ]
    lines = []
    for measure in ("accuracy", "success"):
        gains = [
            100 * float(full.scores(measure)[0] - bm.scores(measure)[0])
            for _, full, bm in pairs
        ]
        more = sum(gain > 0 for gain in gains)
        listed = ", ".join(f"{gain:+.1f}" for gain in gains)
        lines.append(
            f"- Full knowledge raises {measure}: in {more} of {len(gains)} cells ({listed} points; "
            "one training seed each)."
        )
    earlier = [
        full.best_run.best_step < bm.best_run.best_step
        for _, full, bm in pairs
        if full.best_run
        and bm.best_run
        and full.best_run.best_step
        and bm.best_run.best_step
    ]
    lines.append(
        f"- Its best model comes earlier: in {sum(earlier)} of {len(earlier)} cells; the step of a "
        "maximum of noisy evaluations varies by tens of per cent between seeds."
    )
    reached = [
        (float(group.scores("accuracy")[0]), paper["accuracy"])
        for task in tasks
        for group in task.groups
        if group.best and (paper := published_result(task, group.agent))
    ]
    near = sum(own > published - 0.05 for own, published in reached)
    lines.append(
        f"- Agents reach the published accuracy, less 5 points: {near} of {len(reached)} networks."
    )
    return "\n".join(lines)


def anova_table(tasks: Sequence[TaskData]) -> str:
    """Return the paper's analysis of variance beside its F values."""
    rows = []
    for task in tasks:
        pair = [of(task, agent) for agent in ("full", "bm")]
        rates = []
        for group in pair:
            found = success_rates(group) if group else None
            if found is not None:
                rates.append(found)
        if len(rates) < 2:
            continue
        one, other = rates
        f, p = one_way_anova([one, other])
        paper = published_comparison(task, *(group for group in pair if group))[
            "anova_f"
        ]
        means = [percent(float(each.mean())) for each in (one, other)]
        rows.append([title_of(task), *means, f"{f:.1f}", f"{p:.2g}", f"{paper:.1f}"])
    return table(["cell", "`full`", "`bm`", "F", "p", "paper: F"], rows)


def joint_figures(task: TaskData) -> list[Figure]:
    """Return the report's figure of the joint angles of `full` and `bm`, if both are stored."""
    return [block for block in joint_blocks(task) if isinstance(block, Figure)]


def joints_table(tasks: Sequence[TaskData]) -> str:
    """Return mean and standard deviation of the joints that the paper names."""
    rows = []
    for task in tasks:
        for figure in joint_figures(task):
            for row in figure.table.rows:
                numbers = [f"{row[key]:+.2f}" for key in ("first_mean", "second_mean")]
                numbers += [f"{row[key]:.2f}" for key in ("first_std", "second_std")]
                paper = row["paper_std_change"]
                changes = [
                    f"{row['std_change']:+.2f}",
                    "" if paper is None else f"{paper:+.2f}",
                ]
                rows.append([title_of(task), str(row["joint"]), *numbers, *changes])
    columns = [
        "cell",
        "joint",
        "`full`: mean",
        "`bm`: mean",
        "`full`: std",
        "`bm`: std",
    ]
    return table([*columns, "change", "paper: change"], rows)


def curves(tasks: Sequence[TaskData]) -> str:
    """Draw the interim returns of every cell with their trend lines (paper, section 5)."""
    drawings, legend = [], dict[str, str]()
    for task in tasks:
        figure = curve_figure(task, {"return_mean": RETURN_AXIS}, "return", "return")
        drawings += [panel.svg for panel in figure.panels if panel.only == "large"]
        legend |= dict(figure.legend)
    return picture(drawings, BOXES["large"], legend, 2, list(map(title_of, tasks)))


def joints(tasks: Sequence[TaskData]) -> str:
    """Draw the distributions of the joint angles (paper, section 5)."""
    drawings, legend, titles = [], dict[str, str](), []
    for task in tasks:
        for figure in joint_figures(task):
            drawings += [panel.svg for panel in figure.panels]
            titles += [
                f"{title_of(task)}, joint {row['joint']}" for row in figure.table.rows
            ]
            legend |= dict(figure.legend)
    return picture(drawings, JOINTS_BOX, legend, 4, titles)


def strips(tasks: Sequence[TaskData], path: Path) -> None:
    """Draw an episode of `bm` above the same episode of `full`, for every cell."""
    rows = []
    for task in tasks:
        pair = [
            group.best
            for agent in ("bm", "full")
            if (group := of(task, agent)) and group.best
        ]
        common = (
            set.intersection(*(set(each.films()) for each in pair))
            if len(pair) == 2
            else ()
        )
        rows += [strip(each, min(common)) for each in pair if common]
    if rows:
        Image.fromarray(np.concatenate(rows)).save(path, optimize=True)


def strip(evaluation: Evaluation, number: int) -> np.ndarray:
    """Return images of an episode beside each other, (SIDE, FRAMES * SIDE, 3) uint8."""
    frames = read_film(evaluation.films()[number])
    places = np.linspace(0, len(frames) - 1, FRAMES).round().astype(int)
    images = [
        Image.fromarray(frames[i]).resize((SIDE, SIDE), Image.Resampling.NEAREST)
        for i in places
    ]
    return np.concatenate([np.asarray(each) for each in images], axis=1)


def state_of(folder: Path) -> str:
    """Say which cells are complete, and why the others are not."""
    runs = study_status(open_study(folder), folder)
    others = [
        f"`{run.name}` ({run.detail or run.state})"
        for run in runs
        if run.state != "done"
    ]
    if others:
        complete = f"{len(runs) - len(others)} of {len(runs)} runs are complete"
        return f"{complete}; not: {', '.join(others)}."
    return f"All {len(runs)} runs are complete."


def page(folder: Path, images: Path) -> str:
    """Return the page of a study, and write its figures."""
    tasks = list(collect([folder]).tasks)
    steps = max(run.config.total_steps for task in tasks for run in task.runs) / 1e6
    (images / "paper-curves.svg").write_text(curves(tasks), encoding="utf-8")
    (images / "paper-joints.svg").write_text(joints(tasks), encoding="utf-8")
    strips(tasks, images / "paper-strips.png")
    return wrapped(
        "\n\n".join(
            [
                HEAD,
                "**Which of the paper's sentences hold here:**",
                sentences(tasks),
                cells_table(tasks),
                f"## Outcomes\n\n{OUTCOMES_TEXT}",
                outcomes_table(tasks),
                "![Interim returns of every cell](../images/paper-curves.svg)",
                PROTOCOL.format(steps=f"{steps:g}", state=state_of(folder)),
                f"## Analysis of variance\n\n{ANOVA}",
                anova_table(tasks),
                f"## Joint angles\n\n{JOINTS}",
                joints_table(tasks),
                "![Distributions of the joint angles](../images/paper-joints.svg)",
                "## Episodes\n\nThe same episode of `bm` (above) and `full` (below), by cell.",
                "![Film strips](../images/paper-strips.png)",
            ]
        )
    )


def main() -> None:
    """Write the page and its figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pack", type=Path, default=PACK)
    parser.add_argument(
        "--out", type=Path, default=ROOT / "docs" / "results" / "paper.md"
    )
    parser.add_argument("--images", type=Path, default=ROOT / "docs" / "images")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.pack
        if not folder.is_dir():
            folder = unpack_study(folder, Path(temporary) / "study")
        given.out.write_text(page(folder, given.images) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
