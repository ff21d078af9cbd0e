"""Nothing goes in; what a report knows of runs, agents and tasks comes out."""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from knowarm.experiment.evaluation_files import read_table

Curve = dict[str, np.ndarray]
"""Columns of one CSV log, (n,) float64 each, nan where a cell was empty; ``step`` increases."""


@dataclass(frozen=True)
class Problem:
    """Something that was wrong with a folder, and what the report did about it.

    Attributes:
        path: the folder or file.
        what: what was found.
        done: what happened to it: left out, or merged by which rule.
    """

    path: Path
    what: str
    done: str


@dataclass(frozen=True, eq=False)
class Judged:
    """One post-training evaluation.

    Attributes:
        folder: where it lies.
        summary: its ``summary.json``.
    """

    folder: Path
    summary: dict[str, Any]

    def episodes(self) -> dict[str, np.ndarray]:
        """Columns of its ``episodes.parquet``."""
        return read_table(self.folder / "episodes.parquet")

    def steps(self, names: list[str] | None = None) -> dict[str, np.ndarray]:
        """Columns of its ``steps.parquet``."""
        return read_table(self.folder / "steps.parquet", names)

    @property
    def has_steps(self) -> bool:
        """Whether the steps were kept."""
        return (self.folder / "steps.parquet").is_file()

    def films(self) -> dict[int, Path]:
        """Films by the number of their episode."""
        found = (self.folder / "films").glob("*.webp")
        return {int(path.stem): path for path in sorted(found) if path.stem.isdigit()}


@dataclass(frozen=True, eq=False)
class Run:
    """One run folder that could be read.

    Attributes:
        path: the folder.
        config: the resolved configuration.
        provenance: versions, machine, parameters, knowledge; empty when missing.
        interim: columns of ``evaluations.csv``; empty when there are none.
        metrics: columns of ``metrics.csv``; empty when there are none.
        judged: post-training evaluations by label.
    """

    path: Path
    config: dict[str, Any]
    provenance: dict[str, Any]
    interim: Curve
    metrics: Curve
    judged: dict[str, Judged]

    @property
    def agent(self) -> str:
        """Name of the agent."""
        return str(self.config["agent"])

    @property
    def seed(self) -> int:
        """Training seed."""
        return int(self.config["seed"])

    @property
    def steps_done(self) -> float:
        """Environment steps the run has seen by its last row."""
        ends = [curve["step"][-1] for curve in (self.interim, self.metrics) if curve]
        return float(max(ends, default=0))

    @property
    def total_steps(self) -> float | None:
        """Environment steps the run was to make."""
        return self.config.get("total_steps")

    @cached_property
    def best_step(self) -> float | None:
        """Step of the best interim model by mean return, the one that is evaluated."""
        if not self.interim or "return_mean" not in self.interim:
            return None
        returns = self.interim["return_mean"]
        if np.isnan(returns).all():
            return None
        return float(self.interim["step"][int(np.nanargmax(returns))])


@dataclass(frozen=True, eq=False)
class Group:
    """Runs of one agent on one task that differ in nothing but the training seed.

    Attributes:
        name: the agent, with the settings that tell it from others of the same name.
        agent: the agent.
        runs: by seed.
        label: which evaluation of each run the task compares; None when there is none.
    """

    name: str
    agent: str
    runs: tuple[Run, ...]
    label: str | None

    @property
    def judged_runs(self) -> tuple[Run, ...]:
        """Runs that have the evaluation the task compares."""
        return tuple(run for run in self.runs if self.label in run.judged)

    def judged(self) -> list[Judged]:
        """The compared evaluation of every run that has it."""
        return [run.judged[self.label] for run in self.judged_runs if self.label]

    def scores(self, key: str) -> np.ndarray:
        """(n,) float64: one number of the summary a run."""
        return np.array([each.summary[key] for each in self.judged()], dtype=np.float64)

    def best_run(self) -> Run | None:
        """The run with the highest mean return after training, as the paper picks models."""
        runs = self.judged_runs
        if not runs or self.label is None:
            return None
        label = self.label
        return max(runs, key=lambda run: run.judged[label].summary["return_mean"])


@dataclass(frozen=True)
class Reference:
    """An evaluation that belongs to no run, such as the untrained policy's.

    Attributes:
        name: as the report shows it.
        judged: the evaluation.
    """

    name: str
    judged: Judged


@dataclass(frozen=True, eq=False)
class Task:
    """Everything that was trained on one robot, colour setting and algorithm.

    Attributes:
        name: short, for anchors and file names.
        title: for people.
        robot: name of the robot.
        colours: "fixed" or "randomized".
        algorithm: name of the algorithm.
        label: which evaluation is compared; None when no run has one.
        groups: one an agent.
        references: evaluations of the same episodes without a run.
    """

    name: str
    title: str
    robot: str
    colours: str
    algorithm: str
    label: str | None
    groups: tuple[Group, ...]
    references: tuple[Reference, ...] = ()

    def group(self, name: str) -> Group | None:
        """The group of that name."""
        return next((group for group in self.groups if group.name == name), None)

    @property
    def runs(self) -> list[Run]:
        """Runs of all groups."""
        return [run for group in self.groups for run in group.runs]


@dataclass(frozen=True)
class Study:
    """Everything a report is computed from.

    Attributes:
        tasks: tasks by title.
        problems: what was wrong, by path.
    """

    tasks: tuple[Task, ...]
    problems: tuple[Problem, ...] = field(default=())

    @property
    def runs(self) -> list[Run]:
        """Runs of all tasks."""
        return [run for task in self.tasks for run in task.runs]
