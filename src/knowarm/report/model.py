"""Data of a report: the tasks, agents, runs and evaluations that it is computed from."""

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from knowarm.config import to_dict
from knowarm.errors import UserError
from knowarm.experiment.agents import AGENTS, Role
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.provenance import Provenance
from knowarm.experiment.summary import AGAIN, EPISODE_COLUMNS, Summary, read_table
from knowarm.learn.algorithms import privileged_uses
from knowarm.report.format import palette
from knowarm.statistics import Interval, mean_of_runs


@dataclass(frozen=True, eq=False)
class Evaluation:
    """One post-training evaluation."""

    folder: Path
    summary: Summary  # its settings and numbers

    def episodes(self, *further: str) -> dict[str, np.ndarray]:
        """Read the columns of ``episodes.parquet``: `EPISODE_COLUMNS` and those given."""
        path = self.folder / "episodes.parquet"
        columns = _complete(path, {*EPISODE_COLUMNS, *further})
        if len(columns["episode"]) != self.summary["episodes"]:
            raise UserError(f"{path} has another number of episodes than the summary. {AGAIN}")
        return columns

    def joint_angles(self) -> dict[int, np.ndarray]:
        """Read the angles of each joint [rad] at all steps from ``steps.parquet``."""
        columns = _complete(self.folder / "steps.parquet", {"step"})
        found = ((re.fullmatch(r"joint_(\d{1,3})_rad", name), name) for name in columns)
        joints = sorted((int(each[1]), name) for each, name in found if each)
        return {joint: columns[name].astype(np.float64) for joint, name in joints}

    def films(self) -> dict[int, Path]:
        """Return the recorded films by episode number."""
        found = sorted((self.folder / "films").glob("*.webp"))
        numbered = [path for path in found if path.stem.isascii() and path.stem.isdigit()]
        count = self.summary["episodes"]
        return {int(path.stem): path for path in numbered if int(path.stem) < count}


@dataclass(frozen=True, eq=False)
class Evaluated:
    """Evaluations of one agent on the same episodes."""

    name: str  # name shown in the report
    evaluations: Sequence[Evaluation]  # one evaluation per training seed

    def scores(self, key: str) -> np.ndarray:
        """Return one number of the summary per evaluation, (n,) float64."""
        return np.array([each.summary[key] for each in self.evaluations], dtype=np.float64)

    def level(self, key: str, group: str = "", value: str = "") -> Interval | None:
        """Estimate the mean of one number of the summary over the evaluations.

        The interval is that of `mean_of_runs`, and of a single evaluation the stored one over its
        episodes. ``group`` and ``value`` as in `Summary.of`; None without a number.
        """
        intervals = [
            each.summary.interval(key, group, value)
            for each in self.evaluations
            if key in each.summary.of(group, value)
        ]
        if len(intervals) < 2:
            return intervals[0] if intervals else None
        return mean_of_runs(intervals)


class Reference(Evaluated):
    """The evaluation of an untrained policy, alone, shown for comparison."""


def _complete(path: Path, needed: Collection[str]) -> dict[str, np.ndarray]:
    """Read the columns of a table; refuse missing columns, rows and values."""
    columns = read_table(path)
    missing = [name for name in sorted(needed) if name not in columns or not len(columns[name])]
    if missing:
        raise UserError(f"{path} lacks values of {', '.join(missing)}. {AGAIN}")
    for name, values in columns.items():
        is_number = values.dtype.kind in "biuf" and bool(np.isfinite(values).all())
        if not is_number and not all(isinstance(value, str) for value in values):
            raise UserError(f"{path} has damaged values of {name}. {AGAIN}")
    return columns


# Columns of one CSV log, (n,) float64 each, NaN where a cell was empty; ``step`` increases.
Curve = dict[str, np.ndarray]
# Roles of agents, in the order in which a report lists them.
ROLES = ("baseline", "knowledge", "privileged", "capacity_control", "content_control")
CONTROLS = ("capacity_control", "content_control")


class FolderProblem(NamedTuple):
    """A defect of a folder or file, and how the report handled it."""

    path: Path  # the folder or file
    what: str  # what was found
    done: str  # how it was handled: left out, or kept in which form


@dataclass(frozen=True, eq=False)
class RunData:
    """One readable run folder."""

    path: Path
    config: ExperimentConfig
    settings: dict[str, Any]  # the same as JSON values, files of the user by their content
    provenance: Provenance  # versions, machine, parameter counts, knowledge; empty if missing
    interim: Curve  # columns of ``evaluations.csv``; empty if missing
    metrics: Curve  # columns of ``metrics.csv``; empty if missing
    evaluations: dict[str, Evaluation]  # post-training evaluations by label
    ended_early: bool = False  # whether its ``stop_when`` ended the training

    @property
    def steps_done(self) -> float:
        """Environment steps of the run's last log row."""
        return float(max((c["step"][-1] for c in (self.interim, self.metrics) if c), default=0))

    @cached_property
    def best_step(self) -> float | None:
        """Step of the interim evaluation with the highest mean return: the evaluated model."""
        returns = self.interim.get("return_mean", np.empty(0))
        return float(self.interim["step"][int(np.nanargmax(returns))]) if returns.size else None

    @property
    def has_success_curve(self) -> bool:
        """Whether interim success is known at every interim evaluation."""
        known = bool(self.interim) and np.isfinite(self.interim.get("success", np.nan)).all()
        return bool(known) and bool(self.interim["step"][-1] > 0)

    def lasts(self, until: float) -> bool:
        """Whether success is known until a step, give or take a rollout, or its rule ended it."""
        return self.has_success_curve and (self.ended_early or self.steps_done >= 0.98 * until)


@dataclass(frozen=True, eq=False)
class Group(Evaluated):
    """Runs of one agent on one task that differ in the training seed only.

    Its name has the settings that tell it from others of the same agent. Its evaluations are those
    that the task compares.
    """

    agent: str
    role: Role
    runs: tuple[RunData, ...]  # runs by seed, at least one
    label: str  # label of the evaluation that the task compares; "" if there is none

    @classmethod
    def of(cls, name: str, runs: Sequence[RunData], label: str) -> "Group":
        """Return the runs as a group."""
        evaluations = [run.evaluations[label] for run in runs if label in run.evaluations]
        return cls(name, evaluations, runs[0].config.agent, runs[0].config.role, tuple(runs), label)

    @property
    def scope(self) -> str:
        """Scope of the knowledge vector, a `knowarm.knowledge.config.Scope`."""
        return self.runs[0].config.knows.scope

    @property
    def has_content(self) -> bool:
        """Whether the agent has a knowledge vector that is not all zeros."""
        return self.runs[0].config.knows.has_content

    @property
    def best_run(self) -> RunData | None:
        """The run with the highest mean return after training, the paper's choice."""
        runs = [run for run in self.runs if self.label in run.evaluations]
        return runs[int(np.argmax(self.scores("return_mean")))] if runs else None

    @property
    def best(self) -> Evaluation | None:
        """The compared evaluation of the best run."""
        return self.best_run.evaluations[self.label] if self.best_run else None


@dataclass(frozen=True, eq=False)
class SplitGroup(Evaluated):
    """One agent on the queries of one split."""

    group: Group
    split: str  # name of the split

    @property
    def chance(self) -> float:
        """Share of right choices of an agent that chooses at random."""
        return self.evaluations[0].summary["choice_chance"]


@dataclass(frozen=True, eq=False)
class TaskData:
    """All runs of one robot, environment configuration and algorithm."""

    name: str  # short name for anchors and file names
    title: str  # title shown in the report
    label: str  # label of the compared evaluation; "" if no run has one
    groups: tuple[Group, ...]  # one per agent, in the order of `ROLES`
    references: tuple[Reference, ...] = ()  # untrained policies on the same episodes

    @property
    def runs(self) -> list[RunData]:
        """Runs of all groups."""
        return [run for group in self.groups for run in group.runs]

    @property
    def key(self) -> tuple[str, str]:
        """Robot and colour setting."""
        env = self.groups[0].runs[0].config.env
        return env.robot, env.colours

    @property
    def is_published(self) -> bool:
        """Whether the task is the paper's, and learned from its reward."""
        config = self.groups[0].runs[0].config
        return not (
            config.env.task.title or "teacher" in privileged_uses(to_dict(config.algorithm))
        )

    @cached_property
    def baseline(self) -> Group | None:
        """The agent without knowledge."""
        return next((group for group in self.groups if group.role == "baseline"), None)

    @cached_property
    def subjects(self) -> tuple[Group, ...]:
        """The agents whose knowledge is tested: of each role and scope that with most detail."""
        roles = ("knowledge", "privileged")
        groups = [g for role in roles for g in self.groups if g.role == role and g.has_content]
        first: dict[tuple[str | None, str], Group] = {}
        for group in sorted(groups, key=lambda group: -group.runs[0].config.knows.rank):
            first.setdefault((group.role, group.scope), group)
        return tuple(group for group in groups if group in first.values())

    @cached_property
    def colours(self) -> dict[str, str]:
        """Palette class of every group and reference."""
        chosen = palette((group.name, group.agent) for group in self.groups)
        return chosen | {reference.name: "c-faint" for reference in self.references}

    @property
    def horizon(self) -> float:
        """Steps to which every agent with success curves has at least one run; 0 without any.

        A run that its ``stop_when`` ended counts to ``total_steps``.
        """
        runs = [[r for r in g.runs if r.has_success_curve] for g in self.groups]
        ends = [
            [r.config.total_steps if r.ended_early else r.interim["step"][-1] for r in each]
            for each in runs
        ]
        return float(min((max(each) for each in ends if each), default=0.0))


@dataclass(frozen=True)
class StudyData:
    """Everything a report is computed from."""

    tasks: tuple[TaskData, ...]  # tasks by title
    problems: tuple[FolderProblem, ...] = ()  # defects of the folders, by path

    @property
    def runs(self) -> list[RunData]:
        """Runs of all tasks."""
        return [run for task in self.tasks for run in task.runs]


def rank(role: Role, agent: str) -> tuple[int, int, str]:
    """Return the sort key of an agent: by role, then in the registry's order."""
    return ROLES.index(role), [*AGENTS, agent].index(agent), agent
