"""Study model: the tasks, agents, runs and evaluations that a report is computed from."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, get_args

import numpy as np

from knowarm.experiment.agents import AGENTS
from knowarm.experiment.algorithms import algorithm_of
from knowarm.experiment.evaluation_files import read_table
from knowarm.knowledge.config import Detail
from knowarm.knowledge.vectors.placebos import Zeros
from knowarm.report.format import palette
from knowarm.statistics import Interval, bootstrap

Curve = dict[str, np.ndarray]
"""Columns of one CSV log, (n,) float64 each, NaN where a cell was empty; ``step`` increases."""

ROLES = ("baseline", "knowledge", "privileged", "capacity_control", "content_control")
"""Roles of agents, in the order in which a report lists them."""

DETAILS = get_args(Detail)
CONTROLS = ("capacity_control", "content_control")


@dataclass(frozen=True)
class Problem:
    """A defect of a folder or file, and how the report handled it.

    Attributes:
        path: the folder or file.
        what: what was found.
        done: how it was handled: left out, or kept in which form.
    """

    path: Path
    what: str
    done: str


@dataclass(frozen=True, eq=False)
class Evaluation:
    """One post-training evaluation.

    Attributes:
        folder: its folder.
        summary: content of its ``summary.json``.
    """

    folder: Path
    summary: dict[str, Any]

    @property
    def config(self) -> Mapping[str, Any]:
        """Settings of the evaluation: episodes, thresholds, actions."""
        return self.summary.get("config", {})

    def episodes(self) -> dict[str, np.ndarray]:
        """Read the columns of ``episodes.parquet``."""
        return read_table(self.folder / "episodes.parquet")

    def steps(self) -> dict[str, np.ndarray]:
        """Read the columns of ``steps.parquet``."""
        return read_table(self.folder / "steps.parquet")

    @property
    def has_steps(self) -> bool:
        """Whether the steps of the episodes were stored."""
        return (self.folder / "steps.parquet").is_file()

    def films(self) -> dict[int, Path]:
        """Return the recorded films by episode number."""
        found = (self.folder / "films").glob("*.webp")
        return {int(path.stem): path for path in sorted(found) if path.stem.isdigit()}

    def numbers(self, part: str = "", name: str = "") -> Mapping[str, Any]:
        """Return the summary, or that of one target (``per_target``) or facet (``per_facet``)."""
        return self.summary.get(part, {}).get(name, {}) if part else self.summary

    def interval(self, key: str, part: str = "", name: str = "") -> Interval | None:
        """Return a number of the summary with its interval over episodes, where stored."""
        values = self.numbers(part, name)
        if values.get(key) is None:
            return None
        ends = (values.get(f"{key}_{end}", values[key]) for end in ("low", "high"))
        return Interval(float(values[key]), *map(float, ends))


@dataclass(frozen=True, eq=False)
class Run:
    """One readable run folder.

    Attributes:
        path: the folder.
        config: resolved configuration, in the current run format.
        provenance: versions, machine, parameter counts, knowledge; empty if missing.
        interim: columns of ``evaluations.csv``; empty if missing.
        metrics: columns of ``metrics.csv``; empty if missing.
        evaluations: post-training evaluations by label.
    """

    path: Path
    config: dict[str, Any]
    provenance: dict[str, Any]
    interim: Curve
    metrics: Curve
    evaluations: dict[str, Evaluation]

    @property
    def agent(self) -> str:
        """Name of the agent."""
        return str(self.config["agent"])

    @property
    def role(self) -> str | None:
        """Role of the agent, one of `ROLES`."""
        return self.config.get("role")

    @property
    def seed(self) -> int:
        """Training seed."""
        return int(self.config["seed"])

    @property
    def env(self) -> dict[str, Any]:
        """Configuration of the environment."""
        return self.config["env"]

    @property
    def algorithm(self) -> str:
        """Name of the learning algorithm, or of its trainer for experiments of other names."""
        name = algorithm_of(str(self.config.get("name")))
        return name or str(self.config["algorithm"].get("name", "?"))

    @property
    def knowledge(self) -> Mapping[str, Any]:
        """Configuration of the knowledge vector."""
        return self.config.get("knowledge") or {}

    @property
    def detail(self) -> int:
        """How much of the objects the knowledge vector describes: place in `Detail`."""
        chosen = self.knowledge.get("detail")
        return DETAILS.index(chosen) if chosen in DETAILS else 0

    @property
    def parameters(self) -> Mapping[str, int]:
        """Trainable parameters by part of the network and in ``total``; empty if unknown."""
        return self.provenance.get("parameter_counts") or {}

    @property
    def steps_done(self) -> float:
        """Environment steps of the run's last log row."""
        return float(max((c["step"][-1] for c in (self.interim, self.metrics) if c), default=0))

    @cached_property
    def best_step(self) -> float | None:
        """Step of the interim evaluation with the highest mean return: the evaluated model."""
        returns = self.interim.get("return_mean", np.empty(0))
        known = not np.isnan(returns).all()
        return float(self.interim["step"][int(np.nanargmax(returns))]) if known else None

    @property
    def has_success_curve(self) -> bool:
        """Whether interim success is known at every interim evaluation."""
        return bool(self.interim) and bool(np.isfinite(self.interim.get("success", np.nan)).all())


class Evaluated:
    """Something with one or more evaluations of the same episodes.

    Attributes:
        name: name shown in the report.
        evaluations: one evaluation per training seed.
    """

    name: str
    evaluations: Sequence[Evaluation]

    def scores(self, key: str) -> np.ndarray:
        """Return one number of the summary per evaluation, (n,) float64."""
        return np.array([each.summary[key] for each in self.evaluations], dtype=np.float64)

    def level(self, key: str, part: str = "", name: str = "") -> Interval | None:
        """Estimate the mean of one number of the summary over the evaluations.

        The interval is a bootstrap over training seeds. A single evaluation has the stored
        interval over its episodes, which describes that one network.

        Args:
            key: name of the number in ``summary.json``.
            part: "per_target" or "per_facet" for the number of one target or facet.
            name: the target or facet.

        Returns:
            The estimate, or None if no evaluation has the number.
        """
        found = [each for each in self.evaluations if each.numbers(part, name).get(key) is not None]
        if len(found) < 2:
            return found[0].interval(key, part, name) if found else None
        return bootstrap([np.array([float(each.numbers(part, name)[key]) for each in found])])


@dataclass(frozen=True, eq=False)
class Group(Evaluated):
    """Runs of one agent on one task that differ in the training seed only.

    Attributes:
        name: the agent, with the settings that distinguish it from others of the same name.
        agent: name of the agent.
        role: role of the agent, one of `ROLES`; None if unknown.
        runs: runs by seed, at least one.
        label: label of the evaluation that the task compares; "" if there is none.
    """

    name: str
    agent: str
    role: str | None
    runs: tuple[Run, ...]
    label: str

    @cached_property
    def evaluations(self) -> Sequence[Evaluation]:  # type: ignore[override]
        """The compared evaluation of every run that has it."""
        return [r.evaluations[self.label] for r in self.runs if self.label in r.evaluations]

    @property
    def scope(self) -> str:
        """Scope of the knowledge vector, a `knowarm.knowledge.config.Scope`."""
        return str(self.runs[0].knowledge.get("scope", "scene"))

    @property
    def best_run(self) -> Run | None:
        """The run with the highest mean return after training, the paper's choice."""
        runs = [run for run in self.runs if self.label in run.evaluations]
        returns = [run.evaluations[self.label].summary["return_mean"] for run in runs]
        return runs[int(np.argmax(returns))] if runs else None

    @property
    def best(self) -> Evaluation | None:
        """The compared evaluation of the best run."""
        return self.best_run.evaluations[self.label] if self.best_run else None


@dataclass(frozen=True)
class Reference(Evaluated):
    """An evaluation shown for comparison, such as that of an untrained policy.

    Attributes:
        name: name shown in the report.
        evaluations: the evaluation, alone.
        untrained: whether the policy is an untrained one of the study.
    """

    name: str
    evaluations: tuple[Evaluation]
    untrained: bool = False


@dataclass(frozen=True, eq=False)
class Task:
    """All runs of one robot, environment configuration and algorithm.

    Attributes:
        name: short name for anchors and file names.
        title: title shown in the report.
        label: label of the compared evaluation; "" if no run has one.
        groups: one per agent, in the order of `ROLES`.
        references: evaluations of the same episodes without a trained run.
    """

    name: str
    title: str
    label: str
    groups: tuple[Group, ...]
    references: tuple[Reference, ...] = ()

    @property
    def runs(self) -> list[Run]:
        """Runs of all groups."""
        return [run for group in self.groups for run in group.runs]

    @property
    def key(self) -> tuple[str, str]:
        """Robot and colour setting."""
        env = self.groups[0].runs[0].env
        return str(env.get("robot")), str(env.get("colours", "fixed"))

    @cached_property
    def baseline(self) -> Group | None:
        """The agent without knowledge."""
        return next((group for group in self.groups if group.role == "baseline"), None)

    @cached_property
    def subjects(self) -> tuple[Group, ...]:
        """The agents whose knowledge is tested: of each role and scope that with most detail."""
        told = [g for g in self.groups if g.runs[0].knowledge.get("detail") != "none"]
        told = [g for g in told if g.runs[0].knowledge.get("source", {}).get("kind") != Zeros.kind]
        groups = [g for role in ("knowledge", "privileged") for g in told if g.role == role]
        first: dict[tuple[str | None, str], Group] = {}
        for group in sorted(groups, key=lambda group: -group.runs[0].detail):
            first.setdefault((group.role, group.scope), group)
        return tuple(group for group in groups if group in first.values())

    @cached_property
    def colours(self) -> dict[str, str]:
        """Palette class of every group and reference."""
        chosen = palette((group.name, group.agent) for group in self.groups)
        return chosen | {reference.name: "c-faint" for reference in self.references}

    @property
    def horizon(self) -> float:
        """Steps to which every agent with success curves has at least one run; 0 without any."""
        longest = [
            max(run.interim["step"][-1] for run in group.runs if run.has_success_curve)
            for group in self.groups
            if any(run.has_success_curve for run in group.runs)
        ]
        return float(min(longest, default=0.0))


@dataclass(frozen=True)
class Study:
    """Everything a report is computed from.

    Attributes:
        tasks: tasks by title.
        problems: defects of the folders, by path.
    """

    tasks: tuple[Task, ...]
    problems: tuple[Problem, ...] = ()

    @property
    def runs(self) -> list[Run]:
        """Runs of all tasks."""
        return [run for task in self.tasks for run in task.runs]


def rank(role: str | None, agent: str) -> tuple[int, int, str]:
    """Return the sort key of an agent: by role, then in the registry's order."""
    names = list(AGENTS)
    return (
        ROLES.index(role) if role in ROLES else len(ROLES),
        names.index(agent) if agent in names else len(names),
        agent,
    )
