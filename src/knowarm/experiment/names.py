"""Names of experiments, such as ``irb120-full-fast``, and their configs."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

from knowarm.config import flatten, override
from knowarm.errors import Argument, UserError, unknown_name
from knowarm.experiment.agents import AGENTS, Agent, first_of_role
from knowarm.experiment.algorithms import algorithms
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.knows import NoKnowledge, fits
from knowarm.knowledge import QUERY
from knowarm.world.config import EnvConfig
from knowarm.world.description import SUFFIX
from knowarm.world.robots import DEFAULT_ROBOT, KNOWN_ARMS, ROBOTS, unknown_robot
from knowarm.world.tasks import (
    DEFAULT_TASK,
    combinations,
    find_task,
    split_name,
    task_names,
)
from knowarm.world.tasks.sampling import Colours
from knowarm.world.tasks.task import Task

RANDOMIZED = "-dr"
"""Suffix of the agent for randomized colours, in tasks that leave the colours open."""


@dataclass(frozen=True)
class ExperimentName:
    """Name of an experiment: ``[<robot>-][<task>-]<agent>[-dr]-<algorithm>``.

    ``str`` writes it and `parse` reads it. The parts are names of robots, tasks (`find_task`),
    ``AGENTS`` and ``algorithms``, and the colours of the targets (paper section 4.2.5). An own
    robot is the path of its TOML file, and the name has the file's.
    """

    robot: str
    task: str
    agent: str
    colours: Colours
    algorithm: str

    def __post_init__(self) -> None:
        if not self.robot.endswith(SUFFIX) and self.robot not in _robots():
            raise unknown_robot(self.robot)
        for what, value, names in (
            ("task", self.task, combinations()),
            ("agent", self.agent, AGENTS),
            ("algorithm", self.algorithm, algorithms()),
        ):
            if value not in names:
                raise unknown_name(f"{what} of the experiment", value, names)
        agent = AGENTS[self.agent]
        if not has_experiment(agent, find_task(self.task)):
            tasks = ", ".join(tasks_of(agent))
            raise UserError(
                f"The agent {self.agent!r} has no experiment of the task {self.task!r}; it has "
                f"those of {tasks}."
            )
        allowed = colours_of(self.task)
        if self.colours not in allowed:
            raise UserError(
                f"The task {self.task!r} has {' or '.join(allowed)} colours, got {self.colours!r}."
            )

    def __str__(self) -> str:
        """Return the name."""
        robot = Path(self.robot).stem if self.robot.endswith(SUFFIX) else self.robot
        has_default_colours = self.colours == colours_of(self.task)[0]
        middle = _middle(self.task, self.agent, has_default_colours)
        return f"{robot}-{middle}-{self.algorithm}"

    @classmethod
    def parse(cls, text: str) -> "ExperimentName":
        """Read a name, by default of ``DEFAULT_ROBOT`` and ``DEFAULT_TASK``.

        An error for a part that is missing or unknown lists the nearest names.
        """
        robots = [name for name in _robots() if text.startswith(f"{name}-")]
        robot = max(robots, key=len, default=DEFAULT_ROBOT)
        after_robot = text.removeprefix(f"{robot}-")
        endings = [name for name in algorithms() if after_robot.endswith(f"-{name}")]
        algorithm = max(endings, key=len, default=after_robot.rpartition("-")[2])
        middle = after_robot.removesuffix(algorithm).removesuffix("-")
        if not middle:
            raise UserError(
                "The name of an experiment has the parts ROBOT-TASK-AGENT-ALGORITHM, of which "
                f"robot and task have defaults, got {text!r}. Give the others, such as "
                f"{_example(text)!r}; `knowarm list` shows them."
            )
        head, _, tail = middle.partition("-")
        task, agent = next(split_name(middle), (DEFAULT_TASK, middle))
        colours = colours_of(task)[0]
        if agent not in AGENTS and agent.endswith(RANDOMIZED):
            agent = agent.removesuffix(RANDOMIZED)
            colours = "randomized"
        if not robots and agent not in AGENTS and tail.endswith(tuple(AGENTS)):
            robot = head  # one that is unknown
            agent = tail
        name = cls(robot, task, agent, colours, algorithm)
        if str(name) not in (text, f"{robot}-{text}"):
            raise UserError(
                f"The experiment {text!r} is named {str(name)!r}; give this name."
            )
        return name

    def config(self, **overrides: Any) -> ExperimentConfig:
        """Return the config of the experiment; overrides as in `experiment_config`."""
        agent = AGENTS[self.agent]
        algorithm = algorithms()[self.algorithm]
        task = override(find_task(self.task), {"asked": agent.asked})
        knows = agent.knows
        policy = dict(algorithm.policy)
        if knows.grounding is not None:
            policy |= algorithm.grounded
        elif algorithm.needs_grounding:
            grounded = [name for name, entry in AGENTS.items() if entry.knows.grounding]
            raise UserError(
                f"The algorithm {self.algorithm!r} acts on what a grounding network sees, and the "
                f"agent {self.agent!r} has none. Take one of {', '.join(grounded)}."
            )
        graph = task.asked.graph
        if knows.scope == "query" and graph is not None:
            # described by the graph of the questions
            knows = override(knows, {"graph": graph, "aliases": QUERY.aliases})
        config = ExperimentConfig(
            name=str(self),
            agent=self.agent,
            algorithm_name=self.algorithm,
            role=agent.role,
            total_steps=algorithm.total_steps,
            env=EnvConfig(robot=self.robot, task=task, colours=self.colours),
            knows=knows,
            policy=override(agent.policy, policy, where="policy"),
            algorithm=algorithm.config,
        )
        for values in task.training(self.algorithm):
            config = override(config, values)
        config = override_experiment(config, overrides)
        check_graphs(config, flatten(overrides))
        if "name" in overrides or config.env.robot == self.robot:
            return config
        return replace(config, name=str(replace(self, robot=config.env.robot)))


def _robots() -> list[str]:
    """Return the names of all robots."""
    return [*ROBOTS, *KNOWN_ARMS]


def tasks_of(agent: Agent) -> list[str]:
    """Return the listed tasks of which an agent has experiments."""
    return [name for name in task_names() if has_experiment(agent, find_task(name))]


def has_experiment(agent: Agent, task: Task) -> bool:
    """Return whether an agent has an experiment of a task.

    Its knowledge describes something in it, and what is asked has the fields that it changes.
    """
    names = {field.name for field in fields(task.asked)}
    is_asked = task.asked.kind in agent.asks or not agent.asks
    return is_asked and names.issuperset(agent.asked) and fits(agent.knows, task)


def colours_of(task: str) -> tuple[Colours, ...]:
    """Return the colours that the experiments of a task can have; names leave out the first."""
    fixed = find_task(task).asked.colours
    return ("fixed", "randomized") if fixed is None else (fixed,)


def experiment_names() -> list[str]:
    """List the names of all experiments of the shipped robots."""
    middles: list[str] = []
    for agent, entry in AGENTS.items():
        for task in tasks_of(entry):
            is_default = [True, False][: len(colours_of(task))]
            middles += map(partial(_middle, task, agent), is_default)
    return list(map("-".join, product(ROBOTS, middles, algorithms())))


def _middle(task: str, agent: str, has_default_colours: bool) -> str:
    """Return a name without robot and algorithm."""
    prefix = "" if task == DEFAULT_TASK else f"{task}-"
    suffix = "" if has_default_colours else RANDOMIZED
    return f"{prefix}{agent}{suffix}"


def _example(text: str) -> str:
    """Return a valid name with the parts that a text has."""
    words = (text, *text.split("-"))

    def named_among(names: Collection[str], default: str) -> str:
        return next((word for word in words if word in names), default)

    robot = named_among(_robots(), DEFAULT_ROBOT)
    agent = named_among(AGENTS, first_of_role("knowledge"))
    algorithm = named_among(algorithms(), next(iter(algorithms())))
    task = tasks_of(AGENTS[agent])[0]
    return str(ExperimentName(robot, task, agent, colours_of(task)[0], algorithm))


DEFAULT_EXPERIMENT = _example("")
"""Experiment of the benchmarks, the installation check and the examples."""


def experiment_config(name: str, /, **overrides: Any) -> ExperimentConfig:
    """Return the config of a named experiment.

    Args:
        name: as `ExperimentName.parse` reads it, such as ``irb120-full-ppo``.
        **overrides: fields to change, as `override_experiment` takes them. With another robot,
            ``env={"robot": "arm.toml"}``, the config has the name of its experiment unless
            ``name`` is given.

    Raises:
        UserError: there is no experiment of that name (the message lists the nearest names), or an
            override does not fit.
    """
    return ExperimentName.parse(name).config(**overrides)


def override_experiment(
    config: ExperimentConfig,
    overrides: Mapping[str, Any],
    *,
    where: str = "",
) -> ExperimentConfig:
    """Return a config with other fields.

    Args:
        config: an experiment's.
        overrides: fields to change; a nested config takes a mapping of its fields, such as
            ``algorithm={"num_envs": 64}``. ``graph`` is that of the knowledge and the questions:
            a file, or the name of a shipped one.
        where: place of the overrides, for errors.
    """
    others = dict(overrides)
    graph = others.pop("graph", None)
    if graph is not None:
        task = config.env.task
        of_graph: dict[str, Any] = {}
        if not isinstance(config.knows, NoKnowledge):
            of_graph["knows"] = {"graph": graph}
        if task.asked.graph is not None:
            of_graph["env"] = replace(config.env, task=task.asking(graph=graph))
        if not of_graph:
            raise UserError(
                Argument("graph", graph),
                f" does not concern {config.name}: neither its knowledge nor its questions are of "
                "a graph. Leave it out.",
            )
        config = override(config, of_graph)
    return override(config, others, where=where)


def check_graphs(config: ExperimentConfig, set_fields: Collection[str]) -> None:
    """Refuse knowledge and questions of two graphs if only one of them is set.

    ``set_fields`` are dotted names of the fields that the user has set.
    """
    questions = config.env.task.asked.graph
    if questions is None or isinstance(config.knows, NoKnowledge):
        return
    sets_knowledge = "knows.graph" in set_fields
    sets_questions = "env.task.asked.queries.graph" in set_fields
    if sets_knowledge == sets_questions or "graph" in set_fields:
        return
    known = config.knows.graph
    if known != questions:
        raise UserError(
            f"The questions are of the graph {questions}, and the knowledge is of another one. "
            "For both pass ",
            Argument("graph", known if sets_knowledge else questions),
            "; for two graphs name both: env.task.asked.queries.graph and knows.graph.",
        )
