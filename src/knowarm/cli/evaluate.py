"""``knowarm evaluate``: the post-training evaluation of a trained or scripted agent."""

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, make_dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import tyro
from rich.text import Text
from tyro.conf import Fixed, OmitArgPrefixes, Positional, Suppress, arg

from knowarm.cli.arguments import (
    Command,
    answer_help,
    parse_options,
    read_names,
    take_option,
)
from knowarm.cli.tables import (
    FilePath,
    TableCommand,
    Values,
    print_meeting,
    print_table,
)
from knowarm.config import override, to_dict
from knowarm.errors import UserError, unknown_name
from knowarm.experiment.config import Which
from knowarm.experiment.evaluation import (
    AnyCondition,
    BaseTest,
    DamageTest,
    EvaluationConfig,
    GraphTest,
    HeldOutTest,
    Places,
    PlacesControl,
    PlacesTest,
    Reasoning,
    ReasoningTest,
    SeenTest,
    SplitTest,
)
from knowarm.experiment.other_graphs import meeting, target_names
from knowarm.experiment.probes import (
    BlindProbe,
    FilmsProbe,
    StepsProbe,
    optional_probes,
)
from knowarm.experiment.run_lock import is_locked
from knowarm.experiment.summary import Numbers, Summary, measure
from knowarm.knowledge.formats import read_graph
from knowarm.knowledge.graph.damage import Damage
from knowarm.knowledge.queries.splits import Split
from knowarm.measures import Measure
from knowarm.perception.config import Unclear
from knowarm.statistics import Interval
from knowarm.world.agents import BLIND_AGENTS, SCRIPTED_AGENTS
from knowarm.world.config import EnvConfig
from knowarm.world.tasks import find_task
from knowarm.world.tasks.probe import BaseProbe

ABOUT = """AGENT is a run folder, or a scripted agent of `knowarm list`, which plays in --env:
  knowarm evaluate runs/irb120-full-fast/0
  knowarm evaluate oracle --env.robot tiago --env.task choose"""
FIRST = (
    "json",
    "which",
    "evaluation.episodes",
    "evaluation.seed",
    "evaluation.distance_m",
    "evaluation.angle_deg",
    "conditions.split",
    "conditions.graph",
    *(f"probes.{probe.kind}" for probe in optional_probes()),
    "env.robot",
)
"""The options that `--help` shows."""
MOST_FACETS = 30  # pairs of target and colour up to which each gets a row


@dataclass(frozen=True, kw_only=True)
class EpisodeOptions(EvaluationConfig):
    """Episodes and success criteria; conditions and probes have options of their own."""

    test: Annotated[tuple[AnyCondition, ...], Fixed, Suppress] = ()
    probes: Annotated[tuple[BaseProbe, ...], Fixed, Suppress] = ()


@dataclass(frozen=True, kw_only=True)
class ConditionOptions:
    """Conditions of the test that differ from training; see `knowarm.experiment.evaluation`."""

    held_out: bool = False
    """Play the colours and places that the environment excluded from training."""
    split: Split | None = None
    """Questions of a task with queries: those of this split's test."""
    edited: str | None = None
    """Edited graph of split S5, instead of one that swaps values."""
    graph: str | None = None
    """Another graph, which asks and answers."""
    names: tuple[str, ...] = ()
    """Its names for objects, such as mug=CoffeeMug, or a file of such lines."""
    reasoning: Reasoning | None = None
    """What an agent with a grounding network answers queries by, instead of its own."""
    unclear: Unclear = "guess"
    """What an agent that answers by a graph does if it sees no answer, or several."""
    level: float | None = None
    """How often the right object shall be among those that it counts as possible answers."""
    damage: Damage | None = None
    """Damage the graph that the agent knows."""
    damage_share: float = 0.3
    """Share of the triples about the task's objects that are damaged."""
    damage_seed: int = 0
    """Seed of which triples are damaged, and of the repair."""
    repair: Literal["analogy", "complex"] | None = None
    """Complete the graph that the agent knows by link prediction, after the damage."""
    seen: bool = False
    """Let inverse kinematics with known joint angles move to the frame that a grounding network
    sees, in place of the policy: what a practitioner would try first."""
    places: Places | PlacesControl = "graph"
    """What the agent knows of where objects belong, for tasks that sort them."""

    def test(self) -> list[BaseTest]:
        """Return the conditions in the order in which they apply."""
        conditions: list[BaseTest] = []
        if self.held_out:
            conditions.append(HeldOutTest())
        if self.split is None and self.edited is not None:
            raise UserError("--edited is the graph of split S5: give --split S5.")
        if self.split is not None:
            conditions.append(SplitTest(split=self.split, edited=self.edited))
        if self.graph is not None:
            conditions.append(GraphTest(graph=self.graph, names=read_names(self.names)))
        elif self.names:
            raise UserError("--names are those of another graph: give --graph.")
        reasoning = ReasoningTest(
            by=self.reasoning, unclear=self.unclear, level=self.level
        )
        if reasoning != ReasoningTest():
            conditions.append(reasoning)
        if self.damage is not None or self.repair is not None:
            damage = DamageTest(
                damage=self.damage,
                share=self.damage_share,
                seed=self.damage_seed,
                repair=self.repair,
            )
            conditions.append(damage)
        if self.seen:
            conditions.append(SeenTest())
        if self.places != "graph":
            conditions.append(PlacesTest(places=self.places))
        return conditions


@dataclass(frozen=True, kw_only=True)
class RecordOptions:
    """What is recorded and measured; see `knowarm.experiment.evaluation`."""

    blind_episodes: int = 200
    """Episodes that the blind agents play beside a trained one; 0 plays none."""
    record_steps: bool = True
    """Keep joint angles, action, distance and angle of every step."""
    record_films: int = 6
    """Number of episodes, from the first, whose images are kept."""

    def probes(self) -> list[BaseProbe]:
        """Return the probes."""
        probes: list[BaseProbe] = []
        if self.record_steps:
            probes.append(StepsProbe())
        if self.record_films:
            probes.append(FilmsProbe(episodes=self.record_films))
        if self.blind_episodes:
            probes.append(BlindProbe(episodes=self.blind_episodes))
        probes.extend(
            probe() for probe in optional_probes() if getattr(self, probe.kind)
        )
        return probes


ProbeOptions: type[RecordOptions] = make_dataclass(
    "ProbeOptions",
    [
        (probe.kind, Annotated[bool, arg(help=probe.about)], field(default=False))
        for probe in optional_probes()
    ],
    bases=(RecordOptions,),
    frozen=True,
    kw_only=True,
)
"""The same with a flag per optional probe."""


@dataclass(frozen=True, kw_only=True)
class Evaluate(TableCommand):
    """Evaluate an agent on the episodes of the paper's post-training evaluation."""

    agent: Annotated[Positional[str], arg(metavar="AGENT")]
    """A run folder (runs/irb120-full-fast/0), or a scripted agent (see `knowarm list`)."""
    evaluation: Annotated[EpisodeOptions, OmitArgPrefixes] = field(
        default_factory=EpisodeOptions
    )
    """Episodes and success criteria."""
    conditions: Annotated[ConditionOptions, OmitArgPrefixes] = field(
        default_factory=ConditionOptions
    )
    """Conditions of the test."""
    probes: Annotated[ProbeOptions, OmitArgPrefixes] = field(  # type: ignore[valid-type]
        default_factory=ProbeOptions
    )
    """What is recorded and measured."""
    which: Which = "best"
    """Checkpoint of the run: best interim evaluation, latest, or untrained."""
    perception: FilePath = None
    """Another grounding network than the one that the run was trained with."""
    env: EnvConfig = field(default_factory=EnvConfig)
    """Environment of a scripted agent; a run is evaluated in its own."""
    save: bool = True
    """Save the evaluation in the run folder, where `knowarm report` reads it."""

    @classmethod
    def parse(cls, prog: str, arguments: Sequence[str]) -> Self:
        """Make a command from its options; `--env.task` takes the name of a task."""
        words = answer_help(cls(agent=""), f"{prog} AGENT", arguments, FIRST, ABOUT)
        return parse_with_task(cls, prog, words, agent=tyro.MISSING)

    def result(self) -> Values:
        """Evaluate, print and save."""
        # Imports torch, which takes seconds.
        from knowarm.experiment.evaluate import evaluate
        from knowarm.experiment.load import load_agent

        recorded: RecordOptions = self.probes
        chosen = {"test": self.conditions.test(), "probes": recorded.probes()}
        how = override(EvaluationConfig(), to_dict(self.evaluation) | chosen)
        report = partial(print, file=sys.stderr, flush=True)
        saves = self.save
        if is_scripted(self.agent):
            if self.perception is not None:
                raise UserError(
                    "A scripted agent perceives nothing: leave out --perception."
                )
            default = EnvConfig(robot=self.env.robot)
            for name in ("distance-m", "angle-deg"):
                field_name = f"success_{name.replace('-', '_')}"
                if getattr(self.env, field_name) != getattr(default, field_name):
                    raise UserError(
                        f"--env.success-{name} is of training: give --{name} here."
                    )
            make = SCRIPTED_AGENTS[self.agent].make
            result = evaluate(
                lambda env: make(env, how.seed),
                self.env,
                how,
                agent_name=self.agent,
                report=report,
            )
        else:
            trained = load_agent(
                self.agent,
                which=self.which,
                greedy=how.actions == "greedy",
                seed=how.seed,
                perception=self.perception,
            )
            if is_locked(trained.folder.path):
                report(
                    f"{self.agent} is still training: this is its network of step {trained.step:,}."
                )
            if self.conditions.graph is not None:
                graph = read_graph(self.conditions.graph)
                names = read_names(self.conditions.names)
                print_meeting(meeting(graph, target_names(trained.config.env), names))
            from knowarm.experiment.zoo import is_packaged  # imports torch

            folder = trained.folder.path
            if saves and is_packaged(folder):
                saves = False
                report(
                    f"Nothing is saved in the package: to keep results, copy {folder}."
                )
            result = evaluate(trained, config=how, write=saves, report=report)
        _print(result.summary)
        if result.folder is not None and saves:
            print(f"Saved in {result.folder}")
        return to_dict(result.summary)


def parse_with_task(
    command: type[Command],
    prog: str,
    arguments: Sequence[str],
    **missing: Any,
) -> Command:
    """Make a command with the fields ``agent`` and ``env``; ``missing`` are those without default.

    Only scripted agents take options ``env``. `--env.task` takes the name of a task, or
    package.module:Name.
    """
    words, task = take_option(arguments, "--env.task", "package.module:Name")
    words, robot = take_option(words, "--env.robot", "my_arm.toml")
    options: dict[str, Any] = {}
    env: dict[str, Any] = {}
    if task is not None:
        env["task"] = find_task(task)
    if robot is not None:
        env["robot"] = robot
    if env:
        make: Callable[..., Command] = command
        options["default"] = make(**missing, env=EnvConfig(**env))
    parsed: Any = parse_options(command, prog, words, **options)
    sets_env = any(word.startswith("--env.") for word in arguments)
    if sets_env and not is_scripted(parsed.agent):
        raise UserError("A run has its own environment: leave out the --env options.")
    return parsed


def is_scripted(agent: str) -> bool:
    """Tell whether an agent argument names a scripted agent; otherwise it is a run folder."""
    if agent in SCRIPTED_AGENTS:
        return True
    if "/" not in agent and not Path(agent).exists():
        raise unknown_name("agent or run folder", agent, SCRIPTED_AGENTS)
    return False


def _print(summary: Summary) -> None:
    """Print the results by target and, where they vary and are few, by target and colour."""
    targets = summary.groups["target"]
    facets = summary.groups["facet"]
    title = f"{summary.agent}: {summary.label}"
    _print_groups(title, "target", {"all": summary.numbers, **targets})
    if len(targets) < len(facets) <= MOST_FACETS:
        _print_groups("By target and colour", "target/colour", facets)
    blind = summary.groups.get("blind")
    if blind:
        _print_groups(
            "Blind agents, on the first of these episodes", "blind agent", blind
        )
        for name, entry in BLIND_AGENTS.items():
            print(f"{name}: {entry.about}.")
        gain = measure("vision_gain")
        depends = "" if summary.interval(gain.name).low > 0 else "not "
        points = _cell(gain, summary.numbers)
        print(
            f"Success is {depends}shown to depend on vision: {points} points, the {gain.about}.\n"
        )
    print(
        f"accuracy: within {summary.config.distance_m} m. success: also within "
        f"{summary.config.angle_deg} deg, unless the task says otherwise. [95 % over episodes]"
    )


def _print_groups(title: str, what: str, groups: Mapping[str, Numbers]) -> None:
    """Print one row per group of episodes, and one column per measure that any of them has."""
    names = dict.fromkeys(chain.from_iterable(groups.values()))
    measures = [column for column in map(measure, names) if not column.detail]
    rows = []
    for name, numbers in groups.items():
        rows.append([name, *[_cell(column, numbers) for column in measures]])
    titles = [column.title for column in measures]
    print_table(title, [what, *titles], rows)


def _cell(of: Measure, numbers: Numbers) -> Text:
    from knowarm.report.format import FORMATS, NARROW_SPACE

    number = numbers.get(of.name)
    if number is None:
        return Text("-")
    form = FORMATS[of.format]
    if isinstance(number, Interval):
        text, unit, _ = form(number.estimate).partition(f"{NARROW_SPACE}%")
        low = form(number.low).removesuffix(unit)
        high = form(number.high).removesuffix(unit)
        text = f"{text} [{low}, {high}]{unit}"
    else:
        text = form(number)
    return Text(text.replace(NARROW_SPACE, " "), no_wrap=True)
