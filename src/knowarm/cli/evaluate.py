"""``knowarm evaluate``: the post-training evaluation of a trained or scripted agent."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

import tyro

from knowarm.cli.arguments import Command, answer_help, parse_options, take_option
from knowarm.cli.tables import FilePath, TableCommand, print_table
from knowarm.config import to_dict
from knowarm.errors import UserError, unknown_name
from knowarm.experiment.config import EvaluationConfig, Which
from knowarm.experiment.names import task_for
from knowarm.measures import Measure
from knowarm.statistics import Interval
from knowarm.world.agents import BLIND_AGENTS, SCRIPTED_AGENTS
from knowarm.world.config import EnvConfig
from knowarm.world.tasks import task_type

if TYPE_CHECKING:
    from knowarm.experiment.summary import Numbers, Summary

ABOUT = """
AGENT is the folder of a run, or a scripted agent of `knowarm list`, which plays in --env:
  knowarm evaluate runs/irb120-full-fast/0
  knowarm evaluate oracle --env.robot tiago --env.task choose
"""
FIRST = "json|which|episodes|seed|distance-m|angle-deg|split|graph|lift|env.robot"
"""The options that `--help` shows."""
MOST_FACETS = 30  # pairs of target and colour up to which each gets a row


@dataclass(frozen=True, kw_only=True)
class Evaluate(TableCommand):
    """Evaluate an agent on the episodes of the paper's post-training evaluation."""

    agent: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="AGENT")]
    """A run folder (runs/irb120-full-fast/0), or a scripted agent (see `knowarm list`)."""
    evaluation: Annotated[EvaluationConfig, tyro.conf.OmitArgPrefixes] = field(
        default_factory=EvaluationConfig
    )
    """Episodes and success criteria."""
    which: Which = "best"
    """Checkpoint of the run: best interim evaluation, latest, or untrained."""
    perception: FilePath = None
    """Another perception module than the one that the run was trained with."""
    env: EnvConfig = field(default_factory=EnvConfig)
    """Environment of a scripted agent; a run is evaluated in its own."""
    save: bool = True
    """Save the evaluation in the run folder, where `knowarm report` reads it."""

    @classmethod
    def parse(cls, prog: str, arguments: Sequence[str]) -> Self:
        """Make a command from its options; `--env.task` takes the name of a task."""
        parse = partial(parse_with_task, cls, prog, agent=tyro.MISSING)
        words = answer_help(lambda: parse(["--help"]), f"{prog} AGENT", arguments, FIRST, ABOUT)
        return parse(words)

    def result(self) -> dict[str, Any]:
        """Evaluate, print and save."""
        from knowarm.experiment.evaluate import evaluate  # imports torch, which takes seconds
        from knowarm.experiment.load import load_agent

        if is_scripted(self.agent, self.env):
            if self.perception is not None:
                raise UserError("A scripted agent perceives nothing: leave out --perception.")
            for name in ("success_distance_m", "success_angle_deg"):
                if getattr(self.env, name) != getattr(EnvConfig(), name):
                    given = name.replace("_", "-")
                    wanted = given.removeprefix("success-")
                    raise UserError(f"--env.{given} is of training: give --{wanted} here.")
            agent = SCRIPTED_AGENTS[self.agent].make(self.evaluation.seed)
            result = evaluate(agent, self.env, self.evaluation, agent_name=self.agent)
        else:
            how = self.evaluation
            options: dict[str, Any] = {"which": self.which, "perception": self.perception}
            greedy = how.actions == "greedy"
            trained = load_agent(self.agent, greedy=greedy, seed=how.seed, **options)
            result = evaluate(trained, config=how, write=self.save)
        _print(result.summary)
        if result.folder is not None and self.save:
            print(f"Saved in {result.folder}")
        return to_dict(result.summary)


def parse_with_task(
    command: type[Command], prog: str, arguments: Sequence[str], **missing: Any
) -> Command:
    """Make a command with a field ``env``; ``missing`` are the fields that have no default.

    `--env.task` takes the name of a task, or package.module:Name.
    """
    rest, task = take_option(arguments, "--env.task", "package.module:Name")
    if task is None:
        return parse_options(command, prog, rest)
    env = EnvConfig(task=task_for(task_type(task).kind_of()))
    make: Callable[..., Command] = command
    return parse_options(command, prog, rest, default=make(**missing, env=env))


def is_scripted(agent: str, env: EnvConfig | None = None) -> bool:
    """Tell whether an agent argument names a scripted agent; otherwise it is a run folder.

    A run takes no options ``env``.
    """
    if agent in SCRIPTED_AGENTS:
        return True
    if "/" not in agent and not Path(agent).exists():
        raise unknown_name("agent or run folder", agent, SCRIPTED_AGENTS)
    if env not in (None, EnvConfig()):
        raise UserError("A run has its own environment: leave out the --env options.")
    return False


def _print(summary: "Summary") -> None:
    """Print the results by target and, where they vary and are few, by target and colour."""
    from knowarm.experiment.summary import measure

    targets, facets = (summary.groups[name] for name in ("target", "facet"))
    _print_groups(
        f"{summary.agent}: {summary.label}", "target", {"all": summary.numbers, **targets}
    )
    if len(targets) < len(facets) <= MOST_FACETS:
        _print_groups("By target and colour", "target/colour", facets)
    if blind := summary.groups.get("blind"):
        _print_groups("Blind agents, on the first of these episodes", "blind agent", blind)
        for name, entry in BLIND_AGENTS.items():
            print(f"{name}: {entry.about}.")
        gain = measure("vision_gain")
        shown = summary.interval(gain.name).low > 0
        print(
            f"Success is {'' if shown else 'not '}shown to depend on vision: "
            f"{_cell(gain, summary.numbers)} points, the {gain.about}.\n"
        )
    print(
        f"accuracy: distance <= {summary.config.distance_m} m. success: as the task defines it, "
        f"mostly with angle <= {summary.config.angle_deg} deg, too. [95 % interval over episodes]"
    )


def _print_groups(title: str, what: str, groups: "Mapping[str, Numbers]") -> None:
    """Print one row per group of episodes, and one column per measure that any of them has."""
    from knowarm.experiment.summary import measure  # imports the simulator

    names = dict.fromkeys(name for group in groups.values() for name in group)
    shown = [each for each in map(measure, names) if not each.detail]
    rows = [[name, *(_cell(each, group) for each in shown)] for name, group in groups.items()]
    print_table(title, [what, *(each.title for each in shown)], rows)


def _cell(of: Measure, numbers: "Numbers") -> str:
    from knowarm.report.format import FORMATS, NARROW_SPACE

    number = numbers.get(of.name)
    if number is None:
        return "-"
    form = FORMATS[of.format]
    if not isinstance(number, Interval):
        shown = form(number)
    else:
        shown = f"{form(number.estimate)} [{form(number.low)}, {form(number.high)}]"
    return shown.replace(NARROW_SPACE, " ")
