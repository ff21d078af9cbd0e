"""Studies as data: experiments, seeds, overrides and evaluations, from TOML, JSON or Python."""

import dataclasses
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import cached_property
from pathlib import Path
from typing import Any

from knowarm.config import from_dict, registered, replace, to_dict
from knowarm.errors import UserError, unknown_name
from knowarm.experiment.agents import controls_of
from knowarm.experiment.config import EvaluationConfig, ExperimentConfig
from knowarm.experiment.registry import Colours, experiment_config, experiment_name
from knowarm.experiment.run_folder import write_json
from knowarm.reading import read_json
from knowarm.study.executors import EXECUTORS, Local, RunKey, Where
from knowarm.study.mirrors import MIRRORS

FORMAT = 1
"""Version of ``study.json``."""

FILE = "study.json"
"""The study that a folder holds."""

SHIPPED = {path.stem: path for path in sorted((Path(__file__).parent / "shipped").glob("*.toml"))}
"""The TOML file of every shipped study, by name."""

PACKED = "manifest.json"
"""File that marks the folder of an unpacked study, in which unfinished runs cannot go on."""


@dataclass(frozen=True, kw_only=True)
class Grid:
    """Every combination of robots, colours, agents and algorithms."""

    robots: tuple[str, ...]
    """Robots, as in `knowarm list`."""

    agents: tuple[str, ...]
    """Agents, as in `knowarm list`."""

    algorithms: tuple[str, ...]
    """Algorithms, as in `knowarm list`."""

    colours: tuple[Colours, ...] = ("fixed",)
    """Fixed or randomized colours of the targets."""

    def experiments(self) -> list[str]:
        """Return the names of the experiments."""
        return [
            experiment_name(robot, agent, algorithm, colours)
            for robot in self.robots
            for colours in self.colours
            for agent in self.agents
            for algorithm in self.algorithms
        ]


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
    """Names of experiments, as in `knowarm list`."""

    grid: Grid | None = None
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

    mirrors: tuple[str, ...] = ()
    """Tracking services that receive the curves as well: "wandb", "mlflow"."""

    where: Where = field(
        default_factory=Local,
        metadata=registered(lambda: [type(entry.default) for entry in EXECUTORS.values()]),
    )
    """What executes the runs, and the resources of each."""

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[A-Za-z0-9][\w.-]*", self.name):
            raise UserError(
                f"name must consist of letters, digits, '-', '_' and '.', got {self.name!r}."
            )
        for what, given in (("experiments", self.cells()), ("seeds", self.seeds)):
            if not given:
                raise UserError(f"{what}: a study needs at least one; got none.")
            if twice := sorted({str(each) for each in given if list(given).count(each) > 1}):
                raise UserError(f"{what}: {', '.join(map(repr, twice))} is given twice.")
        labels = [evaluation.folder for evaluation in self.evaluations]
        if len(set(labels)) < len(labels):
            raise UserError(f"evaluations: two have the same label of {labels}; set label.")
        for each in self.overrides_for:
            if not any(fnmatchcase(cell, each.experiments) for cell in self.cells()):
                raise unknown_name("pattern of experiments", each.experiments, self.cells())
        self.runs()
        for name in self.mirrors:
            if name not in MIRRORS:
                raise unknown_name("mirror", name, MIRRORS)

    def cells(self) -> list[str]:
        """Return the names of the experiments."""
        return [*self.experiments, *(self.grid.experiments() if self.grid else [])]

    def runs(self) -> list[ExperimentConfig]:
        """Return the config of every run, experiment by experiment."""
        return list(self._runs.values())

    def run(self, experiment: str, seed: int) -> ExperimentConfig:
        """Return the config of one run.

        Raises:
            UserError: the study has no such run.
        """
        if (experiment, seed) not in self._runs:
            names = [f"{name}/{seed}" for name, seed in self._runs]
            raise unknown_name(f"run of the study {self.name!r}", f"{experiment}/{seed}", names)
        return self._runs[experiment, seed]

    @cached_property
    def _runs(self) -> dict[RunKey, ExperimentConfig]:
        return {
            (each.name, seed): dataclasses.replace(each, seed=seed)
            for each in self._experiments()
            for seed in self.seeds
        }

    def _experiments(self) -> list[ExperimentConfig]:
        return [self._experiment(name) for name in self.cells()]

    def _experiment(self, name: str) -> ExperimentConfig:
        config = experiment_config(name)
        if fixed := sorted({"name", "seed"} & {*self.overrides}):
            raise UserError(f"overrides must not set {fixed[0]!r}; it follows from the study.")
        config = replace(config, self.overrides, where="overrides")
        for each in self.overrides_for:
            if fnmatchcase(name, each.experiments):
                config = replace(config, each.fields, where="overrides_for.fields")
        return config


def read_study(source: Path | str, *, of: Path | str | None = None) -> StudyConfig:
    """Read a study.

    Args:
        source: name of a shipped study, a TOML file, or the folder of a study that was started.
        of: for a study of controls, the study whose agents they control.

    Raises:
        UserError: there is no such study, or it is not valid; for a TOML file with file and line.
    """
    path = Path(source)
    if (path / FILE).is_file():
        values = read_json(path / FILE)
        if values.pop("format", None) != FORMAT:
            raise UserError(f"{path / FILE} was written by another version; run the study again.")
        return from_dict(StudyConfig, values)
    if str(source) in SHIPPED:
        path = SHIPPED[str(source)]
    elif path.suffix != ".toml":
        raise unknown_name("study (name, TOML file or folder of a study)", str(source), SHIPPED)
    try:
        text = path.read_text(encoding="utf-8")
        values = tomllib.loads(text)
    except OSError as error:
        raise UserError(f"Cannot read {path}: {error.strerror}.") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UserError(f"{path} is not TOML: {error}.") from None
    try:
        controlled = values.pop("controls_of", None)
        if of is not None and controlled is None:
            raise UserError(f"{source} is no study of controls: leave out 'of'.")
        if controlled is not None:
            values = to_dict(controls(read_study(of or controlled), "controls")) | values
        return from_dict(StudyConfig, values)
    except UserError as error:
        raise UserError(f"{path}{_line(text, str(error))}: {error}") from error


def write_study(study: StudyConfig, out: Path) -> None:
    """Write ``study.json`` into the study's folder."""
    write_json(out / FILE, {"format": FORMAT, **to_dict(study)})


def controls(study: StudyConfig, name: str) -> StudyConfig:
    """Return the study of the registered controls of a study's agents with knowledge.

    They are trained on the same tasks, with the same seeds, overrides and evaluations.

    Raises:
        UserError: no agent of the study has registered controls.
    """
    found: dict[str, None] = {}
    for config in study._experiments():
        if config.role == "knowledge":
            tail = config.name.removeprefix(f"{config.env.robot}-{config.agent}")
            for role in ("capacity_control", "content_control"):
                for control in controls_of(config.agent, role):
                    found.setdefault(f"{config.env.robot}-{control}{tail}")
    names = tuple(each for each in found if each not in study.cells())
    if not names:
        raise UserError(f"No agent of the study {study.name!r} has registered controls to train.")
    kept = tuple(
        each
        for each in study.overrides_for
        if any(fnmatchcase(each_name, each.experiments) for each_name in names)
    )
    return StudyConfig(
        name=name,
        experiments=names,
        seeds=study.seeds,
        overrides=study.overrides,
        overrides_for=kept,
        evaluations=study.evaluations,
        where=study.where,
    )


def _line(text: str, message: str) -> str:
    """Return ", line N" of the first line with a word that an error message quotes."""
    quoted = re.findall(r"'([^']+)'", message)
    fields = re.findall(r"([\w.\[\]]+)(?: must\b|:| \()", message)
    for word in [*quoted, *(re.split(r"[.\[]", name)[-1].rstrip("]") for name in fields), *fields]:
        pattern = re.compile(rf"(?<!\w){re.escape(word)}(?!\w)")
        for number, line in enumerate(text.splitlines(), 1):
            if word and pattern.search(line.partition("#")[0]):
                return f", line {number}"
    return ""
