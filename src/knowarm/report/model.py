"""Data of a report: the tasks, agents, runs and evaluations that it is computed from."""

import json
import re
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from knowarm.config import to_dict
from knowarm.errors import UserError
from knowarm.experiment.agents import AGENTS, Role
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.evaluation import EvaluationConfig, SeenTest
from knowarm.experiment.provenance import Provenance
from knowarm.experiment.summary import AGAIN, EPISODE_COLUMNS, Summary, read_table
from knowarm.knowledge.queries.splits import SPLITS
from knowarm.statistics import Interval, mean_of_runs

# Suffixes of evaluations other than that of the best model on its training task.
UNTRAINED = "-untrained"
LATEST = "-latest"
HELD_OUT = "-held-out"
# Evaluation settings that do not change the agent's numbers.
NOT_A_RULE = ("probes", "label")


@dataclass(frozen=True, eq=False)
class Evaluation:
    """One post-training evaluation."""

    folder: Path
    summary: Summary  # its settings and numbers

    @cached_property
    def rules(self) -> str:
        """What evaluations by the same rules share: episodes, thresholds, actions."""
        return self._rules(self.summary.config)

    @cached_property
    def policy_rules(self) -> str:
        """The rules of the same evaluation with the policy, where it `is_solved` without."""
        test = [
            condition
            for condition in self.summary.config.test
            if condition != SeenTest()
        ]
        return self._rules(replace(self.summary.config, test=tuple(test)))

    @property
    def is_solved(self) -> bool:
        """Whether inverse kinematics acted in place of the policy, to what its network sees."""
        return SeenTest() in self.summary.config.test

    def _rules(self, config: EvaluationConfig) -> str:
        rules = to_dict(config)
        for name in NOT_A_RULE:
            del rules[name]
        return json.dumps([self.summary["episodes"], rules], sort_keys=True)

    def episodes(self) -> dict[str, np.ndarray]:
        """Read the columns of ``episodes.parquet``, with all of `EPISODE_COLUMNS`."""
        path = self.folder / "episodes.parquet"
        columns = _complete(path, EPISODE_COLUMNS.keys())
        if len(columns["episode"]) != self.summary["episodes"]:
            raise UserError(
                f"{path} has another number of episodes than the summary. {AGAIN}"
            )
        return columns

    def joint_angles(self) -> dict[int, np.ndarray]:
        """Read the angles of each joint [rad] at all steps from ``steps.parquet``."""
        columns = _complete(self.folder / "steps.parquet", {"step"})
        joints = {}
        for name, values in columns.items():
            match = re.fullmatch(r"joint_(\d{1,3})_rad", name)
            if match:
                joints[int(match[1])] = values.astype(np.float64)
        return dict(sorted(joints.items()))

    def films(self) -> dict[int, Path]:
        """Return the recorded films by episode number."""
        films = {}
        for path in sorted((self.folder / "films").glob("*.webp")):
            name = path.stem
            if re.fullmatch("[0-9]+", name) and int(name) < self.summary["episodes"]:
                films[int(name)] = path
        return films


@dataclass(frozen=True, eq=False)
class Evaluated:
    """Evaluations of one agent on the same episodes."""

    name: str  # name shown in the report
    colour: str  # palette class
    evaluations: list[Evaluation]  # one evaluation per training seed

    def scores(self, key: str) -> np.ndarray:
        """Return one number of the summary per evaluation, (n,) float64."""
        scores = [evaluation.summary[key] for evaluation in self.evaluations]
        return np.array(scores, np.float64)

    def level(self, key: str, group: str = "", value: str = "") -> Interval | None:
        """Estimate the mean of one number of the summary over the evaluations.

        The interval is that of `mean_of_runs`, and of a single evaluation the stored one over its
        episodes. ``group`` and ``value`` as in `Summary.of`; None without a number.
        """
        summaries = [evaluation.summary for evaluation in self.evaluations]
        known = [summary for summary in summaries if key in summary.of(group, value)]
        intervals = [summary.interval(key, group, value) for summary in known]
        if len(intervals) > 1:
            return mean_of_runs(intervals)
        return intervals[0] if intervals else None


class Reference(Evaluated):
    """The evaluation of an untrained policy, alone, shown for comparison."""


def _complete(path: Path, needed: Collection[str]) -> dict[str, np.ndarray]:
    """Read the columns of a table; refuse missing columns, rows and values."""
    columns = read_table(path)
    filled = {name for name, values in columns.items() if len(values)}
    missing = sorted(set(needed) - filled)
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
    # The same as JSON values, files of the user by their content.
    settings: dict[str, Any]
    # Versions, machine, parameter counts, knowledge; empty if missing.
    provenance: Provenance
    interim: Curve  # columns of ``evaluations.csv``; empty if missing
    metrics: Curve  # columns of ``metrics.csv``; empty if missing
    evaluations: dict[str, Evaluation]  # post-training evaluations by label
    ended_early: bool = False  # whether its ``stop_when`` ended the training

    @property
    def steps_done(self) -> float:
        """Environment steps of the run's last log row."""
        ends = [curve["step"][-1] for curve in (self.interim, self.metrics) if curve]
        return float(max(ends, default=0))

    @cached_property
    def best_step(self) -> float | None:
        """Step of the interim evaluation with the highest mean return: the evaluated model."""
        if "return_mean" not in self.interim:
            return None
        best = np.nanargmax(self.interim["return_mean"])
        return float(self.interim["step"][best])

    @property
    def success_until(self) -> float:
        """Step until which success is known at every interim evaluation; 0 if it is not."""
        success = self.interim.get("success", np.nan)
        if not np.isfinite(success).all():
            return 0.0
        end = float(self.interim["step"][-1])
        if self.ended_early and end:
            return self.config.total_steps
        return end

    def lasts(self, until: float) -> bool:
        """Whether success is known until a step, give or take a rollout, or its rule ended it."""
        is_long_enough = self.ended_early or self.steps_done >= 0.98 * until
        return is_long_enough and self.success_until > 0


Runs = list[RunData]
Problems = list[FolderProblem]


@dataclass(frozen=True, eq=False)
class Group(Evaluated):
    """Runs of one agent on one task that differ in the training seed only.

    Its name has the settings that tell it from others of the same agent. Its evaluations are those
    that the task compares, or others by the same rules.
    """

    runs: tuple[RunData, ...]  # runs by seed, at least one
    label: str  # label of the evaluation that the task compares; "" if there is none

    @classmethod
    def of(cls, name: str, colour: str, runs: Sequence[RunData], label: str) -> "Group":
        """Return the runs as a group."""
        evaluated = evaluated_runs(runs, label)
        evaluations = [run.evaluations[label] for run in evaluated]
        return cls(
            name=name,
            colour=colour,
            evaluations=evaluations,
            runs=tuple(runs),
            label=label,
        )

    @property
    def config(self) -> ExperimentConfig:
        """Configuration of the runs, but for the seed."""
        return self.runs[0].config

    @property
    def agent(self) -> str:
        """Name of the agent."""
        return self.config.agent

    @property
    def role(self) -> Role:
        """Role of the agent in a comparison."""
        return self.config.role

    @property
    def success_curves(self) -> list[Curve]:
        """Interim curves of the runs whose success is known."""
        return [run.interim for run in self.runs if run.success_until]

    @property
    def scope(self) -> str:
        """Scope of the knowledge vector, a `knowarm.knowledge.config.Scope`."""
        return self.config.knows.scope

    @property
    def split(self) -> str:
        """Name of the split of the queries; without one these are those of training."""
        return self.evaluations[0].summary.config.split or next(iter(SPLITS))

    @property
    def chance(self) -> float:
        """Share of right choices of an agent that chooses at random."""
        return self.evaluations[0].summary["choice_chance"]

    @property
    def best_run(self) -> RunData | None:
        """The run with the highest mean return after training, the paper's choice."""
        runs = evaluated_runs(self.runs, self.label)
        return runs[self.scores("return_mean").argmax()] if runs else None

    @property
    def best(self) -> Evaluation | None:
        """The compared evaluation of the best run."""
        return self.best_run.evaluations[self.label] if self.best_run else None


def evaluated_runs(runs: Iterable[RunData], label: str) -> Runs:
    """Return the runs that have an evaluation."""
    return [run for run in runs if label in run.evaluations]


@dataclass(frozen=True, eq=False)
class TaskData:
    """All runs of one robot, environment configuration and algorithm."""

    name: str  # short name for anchors and file names
    title: str  # title shown in the report
    label: str  # label of the compared evaluation; "" if no run has one
    groups: tuple[Group, ...]  # one per agent, in the order of `ROLES`
    references: tuple[Reference, ...] = ()  # untrained policies on the same episodes

    @property
    def runs(self) -> Runs:
        """Runs of all groups."""
        runs: Runs = []
        for group in self.groups:
            runs += group.runs
        return runs

    @property
    def key(self) -> tuple[str, str]:
        """Robot and colour setting."""
        env = self.groups[0].config.env
        return env.robot, env.colours

    @property
    def agents(self) -> tuple[Evaluated, ...]:
        """Groups and references."""
        return *self.groups, *self.references

    @cached_property
    def baseline(self) -> Group | None:
        """The agent without knowledge."""
        for group in self.groups:
            if group.role == "baseline":
                return group
        return None

    @cached_property
    def subjects(self) -> tuple[Group, ...]:
        """The agents whose knowledge is tested: of each role and scope that with most detail."""
        most: dict[tuple[str, str], Group] = {}
        for group in sorted(self.groups, key=lambda group: -group.config.knows.rank):
            is_subject = group.role in ("knowledge", "privileged")
            if is_subject and group.config.knows.has_content:
                most.setdefault((group.role, group.scope), group)
        return tuple(group for group in self.groups if group in most.values())

    @cached_property
    def evaluation_sets(self) -> dict[tuple[str, str], dict[Group, Group]]:
        """Evaluations of the best models by label and rules, then by agent."""
        sets: dict[tuple[str, str], dict[Group, Group]] = defaultdict(dict)
        for group in self.groups:
            for run in group.runs:
                for label, evaluation in run.evaluations.items():
                    is_other = label.endswith((UNTRAINED, LATEST))
                    if not is_other and not evaluation.is_solved:
                        agents = sets[label, evaluation.rules]
                        agent = agents.setdefault(group, replace(group, evaluations=[]))
                        agent.evaluations.append(evaluation)
        return dict(sorted(sets.items(), key=lambda item: item[0][0]))

    @cached_property
    def splits(self) -> dict[str, list[Group]]:
        """Agents that chose between objects, by split; the most common episodes count."""
        most: Counter[str] = Counter()
        splits = {}
        for by_group in self.evaluation_sets.values():
            agents = list(by_group.values())
            first = agents[0]
            if "choice_chance" not in first.evaluations[0].summary:
                continue
            count = sum(len(agent.evaluations) for agent in agents)
            if count > most[first.split]:
                most[first.split] = count
                splits[first.split] = agents
        return {split: splits[split] for split in SPLITS if split in splits}

    @property
    def horizon(self) -> float:
        """Steps to which every agent with success curves has at least one run; 0 without any.

        A run that its ``stop_when`` ended counts to ``total_steps``.
        """
        ends = []
        for group in self.groups:
            longest = max(run.success_until for run in group.runs)
            if longest:
                ends.append(longest)
        return float(min(ends, default=0.0))


@dataclass(frozen=True)
class StudyData:
    """Everything a report is computed from."""

    tasks: tuple[TaskData, ...]  # tasks by title
    problems: tuple[FolderProblem, ...] = ()  # defects of the folders, by path
    name = ""  # in the names of its tables

    @property
    def runs(self) -> Runs:
        """Runs of all tasks."""
        runs = []
        for task in self.tasks:
            runs += task.runs
        return runs


def rank(config: ExperimentConfig) -> tuple[int, int, str]:
    """Return the sort key of an agent: by role, then in the registry's order."""
    agent = config.agent
    return ROLES.index(config.role), [*AGENTS, agent].index(agent), agent
