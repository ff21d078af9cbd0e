"""Agents of a cell, their outcomes over training seeds, and comparisons, as Markdown tables."""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import CensoredData, logrank

from knowarm.experiment.csv_log import training_seconds
from knowarm.report.model import Group, StudyData, TaskData
from knowarm.statistics import Interval, bootstrap, holm, welch
from knowarm.statistics.survival import area_under_curve, first_crossing

LEVEL = 0.8
FEWEST = 3
"""Fewest seeds of a comparison."""
SIGNIFICANT = 0.05
CONTROLS = {
    "wide": "a network as large, without knowledge",
    "zeros": "a vector of zeros",
    "random": "random numbers of the same lengths",
    "shuffled": "a graph with permuted tails",
}
ROBOTS = {"irb120": "IRB120", "tiago": "TIAGo"}


@dataclass(frozen=True)
class Agent:
    """Outcomes of the training seeds of one agent."""

    name: str
    seeds: tuple[int, ...]
    steps: np.ndarray
    """Steps to the level, (n,), at most those of a training."""
    reached: np.ndarray
    """Whether the level was reached, (n,) bool."""
    success: np.ndarray
    """Success after training, (n,) in 0..1."""
    area: np.ndarray
    """Area under the curve of interim success, (n,) in 0..1."""
    hours: float
    """Wall time of the trainings, one core each [h]."""
    processors: tuple[str, ...]
    """Processor of each training, (n,)."""


def agent(group: Group) -> Agent:
    """Read the outcomes of a group of runs."""
    runs = [run for run in group.runs if group.label in run.evaluations]
    until = float(group.runs[0].config.total_steps)
    found = [
        first_crossing(run.interim["step"], run.interim["success"], LEVEL)
        for run in runs
    ]
    scores = [run.evaluations[group.label].summary["success"] for run in runs]
    return Agent(
        group.name,
        tuple(run.config.seed for run in runs),
        np.array([min(step, until) for step, _ in found]),
        np.array([reached and step <= until for step, reached in found]),
        np.array(scores, np.float64),
        np.array(
            [
                area_under_curve(r.interim["step"], r.interim["success"], until)
                for r in runs
            ]
        ),
        sum(training_seconds(run.metrics["wall_time_s"]) for run in runs if run.metrics)
        / 3600,
        tuple(str(run.provenance.machine["processor"]) for run in runs),
    )


def percent(values: np.ndarray) -> str:
    """Format a mean of shares with its interval over seeds, where these differ."""
    if len(values) == 1:
        return f"{100 * values[0]:.1f}"
    each = bootstrap(values)
    mean, low, high = (f"{100 * v:.1f}" for v in (each.estimate, each.low, each.high))
    return mean if low == high else f"{mean} [{low}, {high}]"


def thousands(values: np.ndarray) -> str:
    """Format a mean of steps with its interval over seeds, if several, in thousands."""
    if len(values) == 1:
        return f"{values[0] / 1e3:,.0f}"
    each = bootstrap(values)
    return f"{each.estimate / 1e3:,.0f} [{each.low / 1e3:,.0f}, {each.high / 1e3:,.0f}]"


@dataclass(frozen=True)
class Comparison:
    """One agent against another: means with intervals of Welch's t test, p of a log-rank test."""

    first: str
    second: str
    steps: Interval
    """Difference in steps to the level."""
    share: Interval
    """The same as a share of the second agent's steps."""
    success: Interval
    """Difference in success after training, 0..1."""
    area: Interval
    """Difference in mean success during training, 0..1."""
    p_value: float

    @classmethod
    def of(cls, first: Agent, second: Agent) -> "Comparison":
        """Compare two agents."""
        steps = welch(first.steps, second.steps).difference
        samples = [
            CensoredData.right_censored(a.steps, ~a.reached) for a in (first, second)
        ]
        base = float(second.steps.mean())
        return cls(
            first.name,
            second.name,
            steps,
            Interval(
                *(each / base for each in (steps.estimate, steps.low, steps.high))
            ),
            welch(first.success, second.success).difference,
            welch(first.area, second.area).difference,
            float(logrank(*samples).pvalue),
        )


def table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = [f"| {' | '.join(line)} |" for line in (columns, *rows)]
    return "\n".join([lines[0], "|---" * len(columns) + "|", *lines[1:]])


def plus(value: float, digits: int = 0) -> str:
    """Format a difference; zero has no sign."""
    return f"{value:+,.{digits}f}" if round(value, digits) else f"{0:.{digits}f}"


def signed(each: Interval, scale: float, digits: int = 0) -> str:
    """Format a difference with its interval."""
    values = (scale * value for value in (each.estimate, each.low, each.high))
    return "{} [{}, {}]".format(*(plus(value, digits) for value in values))


def never(agent: Agent) -> str:
    """Say how many runs of an agent never reached the level."""
    count = int((~agent.reached).sum())
    return f", {count} never" if count else ""


def agents_table(cell: "Cell") -> str:
    """Return the table of the agents of a cell."""
    rows = []
    for name, agent in cell.agents.items():
        steps = thousands(agent.steps) + never(agent)
        rows.append([f"`{name}`", str(len(agent.seeds)), steps, percent(agent.success)])
    return table(["agent", "seeds", "steps to 80 % [thousands]", "success"], rows)


def comparisons(agents: Mapping[str, Agent]) -> list[Comparison]:
    """Compare full and partial knowledge with the baseline, full knowledge with the controls."""
    pairs = [
        (agents[first], agents[second])
        for first, second in (
            ("full", "bm"),
            ("partial", "bm"),
            *(("full", c) for c in CONTROLS),
        )
        if all(
            name in agents and len(agents[name].seeds) >= FEWEST
            for name in (first, second)
        )
    ]
    return [Comparison.of(*pair) for pair in pairs]


@dataclass(frozen=True)
class Cell:
    """One robot and one choice of colours."""

    task: TaskData
    agents: Mapping[str, Agent]
    compared: Sequence[Comparison]

    def of(self, first: str, second: str) -> tuple[Comparison, float] | None:
        """Return a comparison and its corrected p value; None below `FEWEST` seeds."""
        adjusted = holm([each.p_value for each in self.compared])
        pairs = zip(self.compared, adjusted, strict=True)
        return next(
            ((c, p) for c, p in pairs if (c.first, c.second) == (first, second)), None
        )


def cells_of(studies: Sequence[StudyData]) -> list[Cell]:
    """Return the cells of studies; of a cell that two studies have, the first counts.

    An agent that only a later study has joins the cell, compared with the baseline of its study.
    """
    cells: dict[tuple[str, str], Cell] = {}
    for study in studies:
        for task in study.tasks:
            agents = {group.name: agent(group) for group in task.groups}
            agents = {name: each for name, each in agents.items() if each.seeds}
            compared = comparisons(agents)
            known = cells.get(task.key)
            if known is None:
                cells[task.key] = Cell(task, agents, compared)
                continue
            new = [name for name in agents if name not in known.agents]
            cells[task.key] = Cell(
                known.task,
                {**known.agents, **{name: agents[name] for name in new}},
                [*known.compared, *(each for each in compared if each.first in new)],
            )
    return list(cells.values())


def verdict(cell: Cell) -> str:
    """Answer the paper's claim for a cell."""
    title, main = title_of(cell.task), cell.of("full", "bm")
    if main is None:
        return f"**{title}**: not enough seeds."
    compared, p_value = main
    length = f"{signed(compared.share, 100)} % of the steps of `bm`, p {p_value:.2g}"
    points = f"{signed(compared.success, 100, 1)} points of success"
    if p_value >= SIGNIFICANT:
        low = -100 * compared.share.low
        return (
            f"**{title}**: no effect is found ({length}); the interval "
            f"excludes a saving of more than {max(0, low):.0f} %."
            f"{uncorrected(cell, compared)}"
        )
    if compared.share.estimate > 0:
        return f"**{title}**: full knowledge learns more slowly ({length}). {points}."
    tested = {name: pair[1] for name in CONTROLS if (pair := cell.of("full", name))}
    alike = [
        f"`{name}` ({CONTROLS[name]})" for name, p in tested.items() if p >= SIGNIFICANT
    ]
    cause = (
        f"but not than {', '.join(alike)}, so the content of the knowledge is not the reason"
        if alike
        else "and than every control"
        if tested
        else "but no control ran"
    )
    return f"**{title}**: full knowledge learns faster ({length}), {cause}. {points}."


def uncorrected(cell: Cell, compared: Comparison) -> str:
    """Say what follows where the interval of a comparison excludes 0, but its p value does not."""
    if compared.steps.low <= 0 <= compared.steps.high:
        return ""
    against = [pair[0] for name in CONTROLS if (pair := cell.of(compared.first, name))]
    beaten = [f"`{each.second}`" for each in against if each.steps.high < 0]
    controls = f"; so do those against {', '.join(beaten)}" if beaten else ""
    controls = controls or ("; no interval against a control does" if against else "")
    low, high = (
        f"{end / 1e3:+,.0f}" for end in (compared.steps.low, compared.steps.high)
    )
    return f" Uncorrected, the interval [{low}, {high}] thousand steps excludes 0{controls}."


def write_runs(cells: Sequence[Cell], path: Path) -> None:
    """Write the outcomes and the processor of every run to a CSV file."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(
            [
                "robot",
                "colours",
                "agent",
                "seed",
                "success_percent",
                "million_steps",
                "processor",
            ]
        )
        for cell in cells:
            for name, agent in cell.agents.items():
                for run, seed in enumerate(agent.seeds):
                    steps = (
                        f"{agent.steps[run] / 1e6:.2f}"
                        if agent.reached[run]
                        else "never"
                    )
                    success = f"{100 * agent.success[run]:.1f}"
                    outcome = [success, steps, agent.processors[run]]
                    writer.writerow([*cell.task.key, name, seed, *outcome])


def write_comparisons(cells: Sequence[Cell], path: Path) -> None:
    """Write every comparison of two agents of a cell to a CSV file."""
    differences = {
        "steps": 1,
        "steps_percent": 100,
        "success_points": 100,
        "mean_success_points": 100,
    }
    columns = [f"{name}{end}" for name in differences for end in ("", "_low", "_high")]
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["robot", "colours", "first", "second", *columns, "adjusted_p"])
        for cell in cells:
            adjusted = holm([compared.p_value for compared in cell.compared])
            for compared, p_value in zip(cell.compared, adjusted, strict=True):
                intervals = (
                    compared.steps,
                    compared.share,
                    compared.success,
                    compared.area,
                )
                numbers = [
                    f"{scale * end:.1f}"
                    for interval, scale in zip(
                        intervals, differences.values(), strict=True
                    )
                    for end in (interval.estimate, interval.low, interval.high)
                ]
                names = [*cell.task.key, compared.first, compared.second]
                writer.writerow([*names, *numbers, f"{p_value:.2g}"])


def title_of(task: TaskData) -> str:
    """Return robot and colours."""
    robot, colours = task.key
    return f"{ROBOTS[robot]}, {colours} colours"
