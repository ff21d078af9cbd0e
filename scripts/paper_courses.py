"""Courses of the paper's A3C: its falls, its curve with one number changed, its two schedules.

The outcomes are those that the studies `paper-a3c-decay` and `paper-a3c-asynchronous` declare.
"""

from dataclasses import dataclass

import numpy as np

from knowarm.experiment.csv_log import training_seconds
from knowarm.report.model import RunData, Runs, StudyData
from knowarm.statistics import welch
from scripts.answer_a3c import blind_agents
from scripts.answer_cells import plus, signed, table

SMOOTHED = 20
"""Interim evaluations of a running mean: a million steps."""
ARMS = {
    "paper-a3c-decay": "a rate falling to 0",
    "paper-a3c-rewards": "rewards of a hundredth",
}
"""Studies that change one number of the paper, and what they change."""
FIXED, ASYNCHRONOUS = "paper-a3c-fixed", "paper-a3c-asynchronous"
LAST_OF_ARM, LAST_OF_SCHEDULE = 5_000_000, 500_000
"""Steps at the end whose interim evaluations are compared."""
MEASURES = ("return_mean", "success", "accuracy")

ARMS_TEXT = """IRB120, randomized colours, `bm`, one training seed from the same initial weights, up
to {until:g} million steps; return, success and accuracy [%] of the interim evaluations of the last
{last:g} million. One seed decides nothing. Blind, at most: {blind}."""

SCHEDULES_TEXT = """**{lead}.** The same cell, the first {until:g} of 70 million steps, {seeds}
training seeds: the paper's process per worker, and the fixed schedule of all other runs, on busy
cores. Interim evaluations of the last {last:g} million steps, difference of means with 95 %
interval (Welch); {seeds} seeds find none smaller than their scatter. Blind: as above."""

SUCCESS = "success [%]"
SPEED = "steps per second"
SCHEDULE_OUTCOMES = (
    "return",
    SUCCESS,
    "accuracy [%]",
    "return, all steps",
    SPEED,
)


@dataclass(frozen=True)
class Course:
    """Running mean of a run's interim returns."""

    steps: np.ndarray
    """Step of the last evaluation of each mean, (n,)."""
    means: np.ndarray

    @classmethod
    def of(cls, run: RunData, until: float = np.inf) -> "Course | None":
        """Return the course of a run up to a step; None before the first mean."""
        taken = run.interim["step"] <= until
        steps = run.interim["step"][taken]
        returns = run.interim["return_mean"][taken]
        if len(returns) < SMOOTHED:
            return None
        means = np.convolve(returns, np.full(SMOOTHED, 1 / SMOOTHED), "valid")
        return cls(steps[SMOOTHED - 1 :], means)

    @property
    def fall(self) -> tuple[float, float, float]:
        """The largest fall from the highest mean before: size, step before it, step of it."""
        highest = np.maximum.accumulate(self.means)
        end = int((highest - self.means).argmax())
        start = int(self.means[: end + 1].argmax())
        fallen = float(highest[end] - self.means[end])
        return fallen, float(self.steps[start]), float(self.steps[end])


def is_complete(run: RunData) -> bool:
    """Return whether a run has taken all its steps."""
    return run.steps_done >= run.config.total_steps


def only_run(study: StudyData) -> RunData:
    """Return the run of a study that has one."""
    (task,) = study.tasks
    (run,) = task.runs
    return run


def last_means(run: RunData, until: float, last: float) -> list[float]:
    """Return the means of `MEASURES` over the interim evaluations of the last steps."""
    steps = run.interim["step"]
    is_last = (steps > until - last) & (steps <= until)
    return [float(run.interim[measure][is_last].mean()) for measure in MEASURES]


def arms_part(constant: RunData, arms: dict[str, StudyData]) -> list[str]:
    """Return heading, text and table of the arms; nothing before all are complete.

    Args:
        constant: Run of the paper's own numbers.
        arms: Studies by the names of `ARMS`.
    """
    runs = {name: only_run(study) for name, study in arms.items()}
    if runs.keys() != ARMS.keys() or not all(map(is_complete, runs.values())):
        return []
    until = max(run.steps_done for run in runs.values())
    rows = [arm_row("the paper's", constant, until)]
    rows += [arm_row(ARMS[name], run, until) for name, run in runs.items()]
    total = max(run.config.total_steps for run in runs.values())
    groups = [group for study in arms.values() for group in study.tasks[0].groups]
    text = ARMS_TEXT.format(
        until=total / 1e6, last=LAST_OF_ARM / 1e6, blind=blind_agents(groups)
    )
    columns = ["numbers", "return", "success", "accuracy", "highest", "largest fall"]
    return [
        "## One number changed",
        arms_lead(constant, runs, until),
        text,
        table(columns, rows),
    ]


def arms_lead(constant: RunData, runs: dict[str, RunData], until: float) -> str:
    """Say which number raises the success most, and whether the falling rate prevents a fall."""
    success = {
        ARMS[name]: last_means(run, until, LAST_OF_ARM)[1] for name, run in runs.items()
    }
    best = max(success, key=success.__getitem__)
    own = last_means(constant, until, LAST_OF_ARM)[1]
    return (
        f"**With {best} {100 * success[best]:.0f} % succeed, with the paper's numbers "
        f"{100 * own:.0f} %.** With the falling rate the return falls by up to "
        f"{fall_of(runs['paper-a3c-decay'], until):.0f}, with the constant one by up to "
        f"{fall_of(constant, until):.0f}."
    )


def fall_of(run: RunData, until: float) -> float:
    """Return the largest fall of a run up to a step."""
    course = Course.of(run, until)
    assert course is not None, f"{run.path} has fewer than {SMOOTHED} evaluations"
    return course.fall[0]


def arm_row(name: str, run: RunData, until: float) -> list[str]:
    """Return the declared outcomes of an arm."""
    course = Course.of(run, until)
    assert course is not None, f"{run.path} has fewer than {SMOOTHED} evaluations"
    mean, success, accuracy = last_means(run, until, LAST_OF_ARM)
    highest = int(course.means.argmax())
    fallen, before, after = course.fall
    return [
        name,
        plus(mean),
        f"{100 * success:.1f}",
        f"{100 * accuracy:.1f}",
        f"{plus(course.means[highest])} at {course.steps[highest] / 1e6:.1f} M",
        f"{fallen:.0f}, {before / 1e6:.1f} to {after / 1e6:.1f} M",
    ]


def schedules_part(fixed: StudyData, asynchronous: StudyData) -> list[str]:
    """Return heading, text and table of the two schedules; nothing before both are complete."""
    runs = [study.tasks[0].runs for study in (fixed, asynchronous)]
    every_run = [*runs[0], *runs[1]]
    if len(runs[0]) != len(runs[1]) or not all(map(is_complete, every_run)):
        return []
    rows = []
    different = []
    outcomes = [schedule_outcomes(each) for each in runs]
    for column, name in enumerate(SCHEDULE_OUTCOMES):
        of_fixed = outcomes[0][:, column]
        of_asynchronous = outcomes[1][:, column]
        difference = welch(of_asynchronous, of_fixed).difference
        is_speed = name == SPEED
        if not is_speed and (difference.low > 0 or difference.high < 0):
            different.append(name)
        digits = 0 if is_speed else 1
        means = [
            f"{values.mean():.{digits}f}" for values in (of_fixed, of_asynchronous)
        ]
        rows.append([name, *means, signed(difference, 1, digits)])
    total = every_run[0].config.total_steps
    lead = "No difference of what is learned is shown"
    if not np.concatenate(outcomes)[:, SCHEDULE_OUTCOMES.index(SUCCESS)].any():
        lead += ", and no late episode succeeds"
    if different:
        lead = f"What is learned differs: {', '.join(different)}"
    text = SCHEDULES_TEXT.format(
        lead=lead,
        until=total / 1e6,
        seeds=len(runs[0]),
        last=LAST_OF_SCHEDULE / 1e6,
    )
    columns = ["", "fixed", "asynchronous", "difference"]
    return ["## Asynchronous workers", text, table(columns, rows)]


def schedule_outcomes(runs: Runs) -> np.ndarray:
    """Return the declared outcomes of each run, (runs, `SCHEDULE_OUTCOMES`) float64."""
    rows = []
    for run in runs:
        mean, success, accuracy = last_means(run, run.steps_done, LAST_OF_SCHEDULE)
        seconds = training_seconds(run.metrics["wall_time_s"])
        rows.append(
            [
                mean,
                100 * success,
                100 * accuracy,
                float(run.interim["return_mean"].mean()),
                float(run.metrics["step"][-1]) / seconds,
            ]
        )
    return np.array(rows)
