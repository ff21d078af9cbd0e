"""Builds `docs/results/paper.md`, the paper's experiment, and its figures from the packs.

    python -m scripts.build_paper

The paper's algorithm is the study `paper-a3c` (src/knowarm/study/shipped/paper-a3c.toml), the fast
learner that of `docs/results/answer.md`.
"""

import argparse
import csv
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from knowarm.experiment.summary import read_film
from knowarm.report.blocks import Figure
from knowarm.report.charts import BOXES, RETURN_AXIS, Box
from knowarm.report.collect import collect
from knowarm.report.model import Evaluation, Group, RunData, StudyData, TaskData
from knowarm.report.pages.behaviour import joint_blocks
from knowarm.report.pages.differences import success_rates
from knowarm.report.pages.paper import published_comparison, published_result
from knowarm.report.pages.training import curve_figure
from knowarm.statistics import Interval, one_way_anova, share_difference
from knowarm.study.pack import unpack_study
from scripts.answer_cells import cells_of, percent, plus, signed, table, title_of
from scripts.answer_outcomes import Decided
from scripts.build_answer import RESULTS, STUDIES, wrapped
from scripts.figures import picture
from scripts.paper_claims import Row, fast_claims
from scripts.paper_courses import (
    ARMS,
    ASYNCHRONOUS,
    FIXED,
    SMOOTHED,
    Course,
    arms_part,
    is_complete,
    schedules_part,
)

ROOT = Path(__file__).parents[1]
PACK = RESULTS / "paper-a3c.tar.xz"
BEFORE = RESULTS / "paper-a3c-before.csv"
JOINTS_BOX = Box(width=320, height=190, left=40, top=26)
FRAMES, SIDE = 8, 96
"""Images of a film strip, and their size [px]."""
CELLS = [
    (robot, colours)
    for robot in ("irb120", "tiago")
    for colours in ("fixed", "randomized")
]
AGENTS = ("bm", "partial", "full")
COURSES = (*ARMS, FIXED, ASYNCHRONOUS)
"""Studies beside that of the twelve cells."""
BLIND = ("open-loop", "frozen")

HEAD = """<!-- Written by scripts/build_paper.py from the packs; do not edit. -->
# The paper, reproduced"""

LEAD = """**The paper's algorithm has not been trained to its end here: {state}. Nothing about the
knowledge follows from them. With the fast learner and five to ten seeds per agent, no claim of the
paper on learning time or final score is confirmed.**"""

SENTENCES = """What the paper says of the knowledge (section), beside the runs of the [fast
learner](answer.md); steps are those to 80 % success. Statements of method: [line by
line](../reference/paper.md)."""

PROTOCOL = """**Protocol.** *A3C*: `knowarm study run paper-a3c`, the paper's numbers, 17 workers of
one environment, {total:g} million steps, [near start](../reference/world.md#near-start), one
training seed, so no difference of two agents is a result; 1,000 new episodes by the best model so
far, that with the highest mean return of the interim evaluations (40 episodes every 50,000 steps).
*Fast*: the protocol of the [answer](answer.md), far start. Accuracy counts the distance alone (10
cm), success the angle, too (17 degrees). *List*: success of the best fixed list of actions, which
sees nothing; *frozen*: of the network on the first image alone. [Outcomes were declared before
the first
run](../decisions.md#the-outcomes-of-the-papers-experiment-are-declared-before-its-first-run)."""

CURVES = """Begun cells: percent of the best model; mean return of the last {count} interim
evaluations (a million steps). Two earlier trainings were stopped in the drop, {earlier} ([lab
notes](../lab-notes/a3c.md), `paper-a3c-before.csv`)."""

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

ANOVA = """30 evaluation seeds of 100 episodes of each network, success, as the paper's. F compares
two trained networks. It cannot tell the knowledge from the training seed: two seeds of one and the
same agent [differ as much](answer.md#the-papers-analysis-of-variance)."""

JOINTS = """Angles of all steps of the 1,000 episodes [rad], `full` against `bm`; *change* is the
difference of the standard deviations. One network per agent."""

NUMBERS = ("none", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine",
           "ten", "eleven", "all twelve")  # fmt: skip


@dataclass(frozen=True)
class Sources:
    """Studies that the page is computed from."""

    a3c: Sequence[TaskData]
    fast: Sequence[StudyData]
    courses: Mapping[str, StudyData]
    """Studies of `scripts.paper_courses` that are packed, by their names."""

    @classmethod
    @contextmanager
    def read(cls, pack: Path) -> Iterator["Sources"]:
        """Read the packs; ``pack`` is the study of the paper's algorithm or its folder."""
        with tempfile.TemporaryDirectory() as temporary:
            folder = pack
            if not pack.is_dir():
                folder = unpack_study(pack, Path(temporary) / "paper-a3c")
            fast = [
                unpack_study(RESULTS / f"{name}.tar.xz", Path(temporary) / name)
                for name in STUDIES
            ]
            packed = [name for name in COURSES if (RESULTS / f"{name}.tar.xz").exists()]
            courses = {
                name: collect(
                    [unpack_study(RESULTS / f"{name}.tar.xz", Path(temporary) / name)]
                )
                for name in packed
            }
            yield cls(
                a3c=collect([folder]).tasks,
                fast=[collect([each]) for each in fast],
                courses=courses,
            )


def of(tasks: Sequence[TaskData], cell: tuple[str, str], agent: str) -> Group | None:
    """Return the evaluated group of an agent on a cell, of the first task that has it."""
    for task in tasks:
        for group in task.groups:
            if task.key == cell and group.agent == agent and group.best:
                return group
    return None


def share(value: float) -> str:
    """Format a share."""
    return f"{100 * value:.1f}"


def blind(group: Group) -> Row:
    """Return the mean success of a fixed list of actions, and on the first image alone.

    Both are empty where they were not played.
    """
    levels = [group.level("success", "blind", name) for name in BLIND]
    return [share(level.estimate) if level else "" for level in levels]


def state(tasks: Sequence[TaskData]) -> str:
    """Say how many of the paper's cells are complete and begun, and how far these are."""
    wanted = {(*cell, agent) for cell in CELLS for agent in AGENTS}
    runs = [
        run
        for task in tasks
        for group in task.groups
        for run in group.runs
        if (*task.key, group.agent) in wanted
    ]
    begun = [run.steps_done / 1e6 for run in runs if not is_complete(run)]
    assert len(runs) - len(begun) < len(wanted), "write the lead of the whole table"
    words = f"of its twelve cells {NUMBERS[len(runs) - len(begun)]} is complete"
    if len(runs) - len(begun) > 1:
        words = words.replace(" is ", " are ")
    if begun:
        total = max(run.config.total_steps for run in runs) / 1e6
        words += (
            f" and {NUMBERS[len(begun)]} are begun, at {min(begun):.0f} to {max(begun):.0f} of "
            f"{total:.0f} million steps"
        )
    return words


def steps_of(run: RunData) -> str:
    """Say how far a run is."""
    steps = f"{run.steps_done / 1e6:.1f} M"
    return steps if is_complete(run) else f"{steps}, begun"


def cells_table(sources: Sources) -> str:
    """Return the twelve cells, and begun controls: the paper's figures, A3C's and the fast ones."""
    rows = []
    fast = [task for study in sources.fast for task in study.tasks]
    for cell in CELLS:
        for agent in (*AGENTS, "zeros"):
            begun = [
                group
                for task in sources.a3c
                for group in task.groups
                if (task.key, group.agent) == (cell, agent)
            ]
            if agent == "zeros" and not begun:
                continue
            own, quick = of(sources.a3c, cell, agent), of(fast, cell, agent)
            task = next(task for task in fast if task.key == cell)
            paper = published_result(task, agent)
            row = [title_of(task), f"`{agent}`"]
            if paper:
                row.append(f"{100 * paper['accuracy']:.0f}")
            else:
                row.append("no control")
            if own and own.best_run:
                row.append(steps_of(own.best_run))
            else:
                row.append(steps_of(begun[0].runs[0]) if begun else "not begun")
            if quick:
                count = str(len(quick.evaluations))
                row += [percent(quick.scores("accuracy")), count, *blind(quick)]
            else:
                row += [""] * (2 + len(BLIND))
            rows.append(row)
    columns = ["cell", "agent", "paper: accuracy", "A3C: steps", "fast: accuracy"]
    columns += ["seeds", "list", "frozen"]
    return table(columns, rows)


def played(group: Group) -> Row:
    """Return accuracy and success of the best model, and the success of two blind agents."""
    if not group.best:
        return [""] * (2 + len(BLIND))
    scores = [group.scores(key)[0] for key in ("accuracy", "success")]
    return [*map(share, scores), *blind(group)]


def courses(tasks: Sequence[TaskData]) -> str:
    """Return a table of the curves of all runs."""
    rows = []
    for task in tasks:
        for group in task.groups:
            for run in group.runs:
                course = Course.of(run)
                if course is None:
                    continue
                highest = int(course.means.argmax())
                fallen, before, after = course.fall
                rows.append(
                    [
                        title_of(task),
                        f"`{group.name}`",
                        *played(group),
                        f"{(run.best_step or 0) / 1e6:.1f} M",
                        f"{plus(course.means[highest])} at {course.steps[highest] / 1e6:.1f} M",
                        f"{fallen:.0f}, {before / 1e6:.1f} to {after / 1e6:.1f} M",
                        plus(course.means[-1]),
                    ]
                )
    columns = ["cell", "agent", "accuracy", "success", "list", "frozen"]
    columns += ["best model at", "highest", "largest fall", "now"]
    return table(columns, rows)


def earlier() -> str:
    """Say which trainings were stopped before this study, and where."""
    runs = []
    for row in csv.DictReader(BEFORE.read_text(encoding="utf-8").splitlines()):
        part = float(row["steps_million"]) / float(row["of_million"])
        runs.append(f"`{row['experiment']}` at {100 * part:.0f} %")
    return " and ".join(runs)


def constant_run(tasks: Sequence[TaskData]) -> RunData | None:
    """Return the run of the paper's numbers that the arms and schedules share a cell with."""
    for task in tasks:
        for group in task.groups:
            if (task.key, group.agent) == (("irb120", "randomized"), "bm"):
                return group.runs[0]
    return None


def course_parts(sources: Sources) -> list[str]:
    """Return the parts of the page on one number changed and on the schedules."""
    parts = []
    constant = constant_run(sources.a3c)
    arms = {name: sources.courses[name] for name in ARMS if name in sources.courses}
    if constant and len(arms) == len(ARMS):
        parts += arms_part(constant, arms)
    if FIXED in sources.courses and ASYNCHRONOUS in sources.courses:
        parts += schedules_part(sources.courses[FIXED], sources.courses[ASYNCHRONOUS])
    return parts


def a3c_claims(tasks: Sequence[TaskData], is_compared: bool) -> list[Row]:
    """Return the rows of the sentences that only the paper's algorithm can judge.

    Args:
        tasks: Cells of the paper's algorithm.
        is_compared: Whether the page shows a training whose rate falls.
    """
    falls = []
    for task in tasks:
        for group in task.groups:
            course = Course.of(group.runs[0])
            if group.agent == "full" and task.key[1] == "randomized" and course:
                fallen, _, step = course.fall
                robot = title_of(task).partition(",")[0]
                falls.append(f"{robot}: {fallen:.0f} at {step / 1e6:.0f} M")
    listed = "; ".join(falls) or "not begun"
    angles = any(joint_figures(task) for task in tasks)
    return [
        [
            "With randomized colours `full` drops and recovers (6)",
            "at 30 M (TIAGo) and 50 M steps (IRB120)",
            f"A3C, largest fall of the mean return so far: {listed}",
            "open",
        ],
        [
            "The constant learning rate may be why (6)",
            "no run without",
            "[beside a falling rate](#one-number-changed)"
            if is_compared
            else "study `paper-a3c-decay`, begun",
            "one network each" if is_compared else "open",
        ],
        [
            "Joints vary less with knowledge (5.3)",
            "-.01 to -.21 rad",
            "[joint angles](#joint-angles)" if angles else "for complete cells of A3C",
            "one network each" if angles else "open",
        ],
    ]


def outcome_rows(tasks: Sequence[TaskData]) -> list[Row]:
    """Return the declared outcomes of every complete run."""
    rows = []
    for task in tasks:
        for group in task.groups:
            for run in group.runs:
                if not is_complete(run) or "strict" not in run.evaluations:
                    continue
                cells = [
                    signed(margin(run, *outcome), 100, 1)
                    for outcome in OUTCOMES.values()
                ]
                name = [title_of(task), f"`{group.name}`", str(run.config.seed)]
                rows.append([*name, *cells])
    return rows


def margin(run: RunData, label: str, measure: str, of_list: str) -> Interval:
    """Return a rate of the best model minus the success of the best fixed list of actions."""
    rate = run.evaluations[label].summary.interval(measure)
    listed = run.evaluations[of_list].summary.interval("success", "blind", "open-loop")
    return share_difference(rate, listed)


def anova_rows(tasks: Sequence[TaskData]) -> list[Row]:
    """Return the paper's analysis of variance beside its F values."""
    rows = []
    for task in tasks:
        pair = [of([task], task.key, agent) for agent in ("full", "bm")]
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
        means = [share(float(each.mean())) for each in (one, other)]
        rows.append([title_of(task), *means, f"{f:.1f}", f"{p:.2g}", f"{paper:.1f}"])
    return rows


def joint_figures(task: TaskData) -> list[Figure]:
    """Return the report's figure of the joint angles of `full` and `bm`, if both are stored."""
    return [block for block in joint_blocks(task) if isinstance(block, Figure)]


JOINT_COLUMNS = (
    *("cell", "joint", "`full`: mean", "`bm`: mean", "`full`: std", "`bm`: std"),
    *("change", "paper: change"),
)


def joint_rows(tasks: Sequence[TaskData]) -> list[Row]:
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
    return rows


def curves(tasks: Sequence[TaskData]) -> str:
    """Draw the interim returns of every cell with their trend lines (paper, section 5)."""
    drawings, legend = [], dict[str, str]()
    for task in tasks:
        figure = curve_figure(task, {"return_mean": RETURN_AXIS}, "return", "return")
        drawings += [panel.svg for panel in figure.panels if panel.only == "large"]
        legend |= dict(figure.legend)
    columns = min(2, len(drawings))
    titles = list(map(title_of, tasks))
    return picture(drawings, BOXES["large"], legend, columns, titles)


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


def strips(tasks: Sequence[TaskData], path: Path) -> bool:
    """Draw an episode of `bm` above the same episode of `full`, for every cell that has films."""
    rows = []
    for task in tasks:
        pair = [
            group.best
            for agent in ("bm", "full")
            if (group := of([task], task.key, agent)) and group.best
        ]
        common = (
            set.intersection(*(set(each.films()) for each in pair))
            if len(pair) == 2
            else ()
        )
        rows += [strip(each, min(common)) for each in pair if common]
    if rows:
        Image.fromarray(np.concatenate(rows)).save(path, optimize=True)
    return bool(rows)


def strip(evaluation: Evaluation, number: int) -> np.ndarray:
    """Return images of an episode beside each other, (SIDE, FRAMES * SIDE, 3) uint8."""
    frames = read_film(evaluation.films()[number])
    places = np.linspace(0, len(frames) - 1, FRAMES).round().astype(int)
    images = [
        Image.fromarray(frames[i]).resize((SIDE, SIDE), Image.Resampling.NEAREST)
        for i in places
    ]
    return np.concatenate([np.asarray(each) for each in images], axis=1)


def page(sources: Sources, images: Path) -> str:
    """Return the page, and write its figures."""
    tasks = sources.a3c
    total = max(run.config.total_steps for task in tasks for run in task.runs) / 1e6
    (images / "paper-curves.svg").write_text(curves(tasks), encoding="utf-8")
    cells = cells_of(sources.fast)
    known = Decided.of(sources.fast, [cell.task for cell in cells])
    claims = fast_claims(cells, known)
    assert all("not found" in verdict for *_, verdict in claims[:4]), "write the lead"
    beside = course_parts(sources)
    claims += a3c_claims(
        tasks, is_compared=any("One number" in part for part in beside)
    )
    parts = [
        HEAD,
        LEAD.format(state=state(tasks)),
        SENTENCES,
        table(["the paper says", "the paper", "here", "verdict"], claims),
        "## The twelve cells",
        cells_table(sources),
        PROTOCOL.format(total=total),
        "## Curves of A3C",
        "![Interim returns of A3C](../images/paper-curves.svg)",
        CURVES.format(count=SMOOTHED, earlier=earlier()),
        courses(tasks),
        *beside,
    ]
    outcomes = outcome_rows(tasks)
    if outcomes:
        columns = ["cell", "agent", "seed", *OUTCOMES]
        parts += ["## Outcomes", table(columns, outcomes)]
    variances = anova_rows(tasks)
    if variances:
        columns = ["cell", "`full`", "`bm`", "F", "p", "paper: F"]
        parts += ["## Analysis of variance", ANOVA, table(columns, variances)]
    angles = joint_rows(tasks)
    if angles:
        (images / "paper-joints.svg").write_text(joints(tasks), encoding="utf-8")
        figure = "![Distributions of the joint angles](../images/paper-joints.svg)"
        parts += ["## Joint angles", JOINTS, table(JOINT_COLUMNS, angles), figure]
    if strips(tasks, images / "paper-strips.png"):
        text = "The same episode of `bm` (above) and `full` (below), by cell."
        figure = "![Film strips](../images/paper-strips.png)"
        parts += ["## Episodes", text, figure]
    return wrapped("\n\n".join(parts))


def main() -> None:
    """Write the page and its figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pack", type=Path, default=PACK)
    parser.add_argument("--out", type=Path, default=RESULTS / "paper.md")
    parser.add_argument("--images", type=Path, default=ROOT / "docs" / "images")
    given = parser.parse_args()
    with Sources.read(given.pack) as sources:
        text = page(sources, given.images)
    given.out.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
