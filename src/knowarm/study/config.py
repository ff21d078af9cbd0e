"""Studies as data: experiments, seeds, overrides and evaluations, from TOML, JSON or Python."""

import dataclasses
import fnmatch
import re
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any, Literal

from knowarm.config import file_name, flatten, from_dict, to_dict
from knowarm.errors import UserError, unknown_name
from knowarm.experiment.agents import AGENTS, controls_of
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.evaluation import EvaluationConfig
from knowarm.experiment.names import (
    ExperimentName,
    check_graphs,
    colours_of,
    experiment_config,
    override_experiment,
    tasks_of,
)
from knowarm.knowledge.queries.splits import SEEDS
from knowarm.reading import read_json, read_text, read_toml, write_json
from knowarm.study.executor import RunKey, Where
from knowarm.world.description import check_trusted, trust
from knowarm.world.tasks import DEFAULT_TASK
from knowarm.world.tasks.sampling import Colours

FORMAT = 1  # of study.json
MAX_RUNS = 2000  # of a study
STUDY_FILE = "study.json"  # the study that a folder holds
# Marks an unpacked study, whose unfinished runs cannot be resumed.
PACKED = "manifest.json"

SHIPPED = {
    path.stem: path
    for path in sorted((Path(__file__).parent / "shipped").glob("*.toml"))
}
"""The TOML file of every shipped study, by name."""


@dataclass(frozen=True, kw_only=True)
class ExperimentGrid:
    """Every combination of robots, colours, agents and algorithms in one task."""

    robots: tuple[str, ...]
    """Robots, as in `knowarm list`."""
    agents: tuple[str, ...]
    """Agents, as in `knowarm list`."""
    algorithms: tuple[str, ...]
    """Algorithms, as in `knowarm list`."""
    task: str = DEFAULT_TASK
    """Task of all of them."""
    colours: tuple[Colours, ...] | None = None
    """Fixed or randomized colours of the targets; None takes the first that the task has."""

    def experiments(self) -> list[str]:
        """Return the names of the experiments."""
        colours = self.colours or colours_of(self.task)[:1]
        parts = product(self.robots, colours, self.agents, self.algorithms)
        names = []
        for robot, colour, agent, algorithm in parts:
            name = ExperimentName(robot, self.task, agent, colour, algorithm)
            names.append(str(name))
        return names


@dataclass(frozen=True, kw_only=True)
class OverridesFor:
    """Overrides of some experiments."""

    experiments: str
    """Pattern of their names, such as ``tiago-*``."""
    fields: Mapping[str, Any]
    """Fields of `ExperimentConfig`, as in `StudyConfig.overrides`."""


@dataclass(frozen=True, kw_only=True)
class StudyConfig:
    """A table of runs: one per experiment and seed.

    Raises:
        UserError: an unknown experiment or field, no experiment or seed, or one given twice.
    """

    name: str
    """Name of the study; its folder is ``runs/<name>`` unless given."""
    about: str = ""
    """What it is for, in a line."""
    experiments: tuple[str, ...] = ()
    """Names of experiments, as in `knowarm list`, for all seeds; NAME/SEED for one seed alone."""
    grid: ExperimentGrid | None = None
    """More experiments: every combination of some parts."""
    seeds: tuple[int, ...]
    """Training seeds of every experiment."""
    overrides: Mapping[str, Any] = field(default_factory=dict)
    """Fields of `ExperimentConfig` that all experiments share; a nested config takes a mapping of
    those of its fields that change."""
    overrides_for: tuple[OverridesFor, ...] = ()
    """Overrides of some experiments, applied after ``overrides`` and in order."""
    evaluations: tuple[EvaluationConfig, ...] = (EvaluationConfig(),)
    """Post-training evaluations of every run."""
    order: Literal["seeds", "listed"] = "seeds"
    """Which runs start first: those of the first seed, the longest before the others; or in the
    order in which they are listed."""
    where: Where = field(default_factory=Where)
    """Resources of the runs."""

    def __post_init__(self) -> None:
        file_name(self, "name")
        cells = self.cells()
        count = len(cells) * len(self.seeds)
        if count > MAX_RUNS:
            raise UserError(
                f"A study has at most {MAX_RUNS:,} runs; these would be {count:,}."
            )
        _check_once("seeds", self.seeds)
        runs = []
        for name, seeds in self._listed():
            runs += [f"{name}/{seed}" for seed in seeds]
        _check_once("experiments", runs)
        labels = [evaluation.folder for evaluation in self.evaluations]
        if len(set(labels)) < len(labels):
            raise UserError(
                f"evaluations: two have the same label of {labels}; set label."
            )
        for rule in self.overrides_for:
            if not fnmatch.filter(cells, rule.experiments):
                raise unknown_name("pattern of experiments", rule.experiments, cells)
        self.runs()

    def cells(self) -> list[str]:
        """Return the names of the experiments."""
        return list(dict.fromkeys(name for name, _ in self._listed()))

    def all_seeds(self) -> list[int]:
        """Return the training seeds that any experiment has."""
        return list(dict.fromkeys(seed for _, seed in self._runs))

    def _listed(self) -> list[tuple[str, tuple[int, ...]]]:
        """Return the names of the experiments with their seeds, as listed."""
        listed: list[tuple[str, tuple[int, ...]]] = []
        for text in self.experiments:
            seeds = self.seeds
            name, _, seed = text.rpartition("/")
            if name and seed.isdecimal():
                text = name
                seeds = (int(seed),)
            listed.append((str(ExperimentName.parse(text)), seeds))
        if self.grid:
            listed += [(name, self.seeds) for name in self.grid.experiments()]
        return listed

    def runs(self) -> list[ExperimentConfig]:
        """Return the config of every run, as listed, experiment by experiment."""
        return list(self._runs.values())

    def run(self, experiment: str, seed: int) -> ExperimentConfig:
        """Return the config of one run."""
        if (experiment, seed) not in self._runs:
            names = [f"{name}/{seed}" for name, seed in self._runs]
            raise unknown_name(
                f"run of the study {self.name!r}", f"{experiment}/{seed}", names
            )
        return self._runs[experiment, seed]

    @cached_property
    def _runs(self) -> dict[RunKey, ExperimentConfig]:
        configs = {name: self._experiment(name) for name in self.cells()}
        runs = {}
        for name, seeds in self._listed():
            config = configs[name]
            for seed in seeds:
                runs[config.name, seed] = dataclasses.replace(config, seed=seed)
        return runs

    def _experiment(self, name: str) -> ExperimentConfig:
        config = experiment_config(name)
        overrides = [self.overrides, *[rule.fields for rule in self.overrides_for]]
        for fixed in ("name", "seed"):
            if any(fixed in fields for fields in overrides):
                raise UserError(
                    f"overrides must not set {fixed!r}; it follows from the study."
                )
        config = override_experiment(config, self.overrides, where="overrides")
        set_by_user = list(flatten(self.overrides))
        for rule in self.overrides_for:
            if fnmatch.filter([name], rule.experiments):
                config = override_experiment(
                    config, rule.fields, where="overrides_for.fields"
                )
                set_by_user += flatten(rule.fields)
        check_graphs(config, set_by_user)
        return config


def _check_once(what: str, values: Collection[object]) -> None:
    """Check that there are values, and none is given twice."""
    if not values:
        raise UserError(f"{what}: a study needs at least one; got none.")
    counts = Counter(map(str, values))
    twice = sorted(repr(value) for value, count in counts.items() if count > 1)
    if twice:
        raise UserError(f"{what}: {', '.join(twice)} is given twice.")


def read_study(source: Path | str, *, of: Path | str | None = None) -> StudyConfig:
    """Read a study.

    Args:
        source: name of a shipped study, a TOML file, or the folder of a study that was started;
            a folder with the name of a shipped study as ``./NAME``, or as a ``Path``.
        of: for a study of controls, the study whose agents they control; for one of a draw, the
            study that it repeats.

    Raises:
        UserError: there is no such study, or it is not valid; for a TOML file with file and line.
    """
    path = Path(source)
    if source not in SHIPPED and (path / STUDY_FILE).is_file():
        values = read_json(path / STUDY_FILE)
        if values.pop("format", None) != FORMAT:
            raise UserError(
                f"{path / STUDY_FILE} was written by another version; run the study again."
            )
        check_trusted(values, path / STUDY_FILE)
        return from_dict(StudyConfig, values)
    if str(source) in SHIPPED:
        path = SHIPPED[str(source)]
    elif path.suffix != ".toml":
        raise unknown_name(
            "study (name, TOML file or folder of a study)", str(source), SHIPPED
        )
    values = read_toml(path)
    controlled = values.pop("controls_of", None)
    redrawn = values.pop("redraws", None)
    usual = controlled or redrawn
    check_trusted(values, path)
    try:
        if usual is not None:
            source_of = of or usual
            studied = read_study(source_of)
            if str(source_of) != usual:
                values["name"] = f"{studied.name}-{values['name']}"
            if redrawn is not None:
                studied = redraw(studied, values.pop("draw", None))
            else:
                studied = controls(studied)
            values = to_dict(studied) | values
        elif of is not None:
            raise UserError(
                f"{source} is no study of controls or of a draw: leave out 'of'."
            )
        return from_dict(StudyConfig, values)
    except UserError as error:
        line = _line(read_text(path, remedy="Restore the file."), str(error))
        raise UserError(f"{path}{line}: {error}") from error


def write_study(study: StudyConfig, out: Path) -> None:
    """Write ``study.json`` into the study's folder."""
    trust(to_dict(study))
    write_json(out / STUDY_FILE, {"format": FORMAT, **to_dict(study)})


def controls(study: StudyConfig) -> StudyConfig:
    """Return the study of the registered controls of a study's agents with knowledge.

    They are trained on the same tasks, with the same seeds, overrides and evaluations.
    """
    cells = study.cells()
    names: list[str] = []
    for subject in map(ExperimentName.parse, cells):
        if AGENTS[subject.agent].role != "knowledge":
            continue
        for role in ("capacity_control", "content_control"):
            for agent in controls_of(subject.agent, role):
                control = str(dataclasses.replace(subject, agent=agent))
                if subject.task in tasks_of(AGENTS[agent]) and control not in [
                    *cells,
                    *names,
                ]:
                    names.append(control)
    if not names:
        raise UserError(
            f"No agent of the study {study.name!r} has registered controls to train."
        )
    rules = [
        rule for rule in study.overrides_for if fnmatch.filter(names, rule.experiments)
    ]
    return dataclasses.replace(
        study,
        name="controls",
        about="",
        experiments=tuple(names),
        grid=None,
        overrides_for=tuple(rules),
    )


def redraw(study: StudyConfig, draw: str) -> StudyConfig:
    """Return a study of questions of a graph on another declared draw, with other episodes.

    The draw's seed decides what training holds out, what is edited, and the episodes of the
    evaluations; see `SEEDS`.
    """
    if draw not in SEEDS:
        raise unknown_name("draw", draw, SEEDS)
    seed = SEEDS[draw]
    rules = list(study.overrides_for)
    tasks = {config.name: config.env.task for config in study.runs()}
    for name, task in tasks.items():
        fields = {"env": {"task": to_dict(task.asking(seed=seed))}}
        rules.append(OverridesFor(experiments=name, fields=fields))
    evaluations = [
        dataclasses.replace(evaluation, seed=seed) for evaluation in study.evaluations
    ]
    return dataclasses.replace(
        study, overrides_for=tuple(rules), evaluations=tuple(evaluations)
    )


def _line(text: str, message: str) -> str:
    """Return ", line N" of the first line with a word that an error message quotes."""
    quoted = re.findall(r"'([^']+)'", message)
    fields = re.findall(r"([\w.\[\]]+)(?: must\b|:| \()", message)
    last_parts = [re.split(r"[.\[]", name)[-1].rstrip("]") for name in fields]
    for word in [*quoted, *last_parts, *fields]:
        pattern = re.compile(rf"(?<!\w){re.escape(word)}(?!\w)")
        for number, line in enumerate(text.splitlines(), 1):
            if word and pattern.search(line.partition("#")[0]):
                return f", line {number}"
    return ""
