"""``knowarm evaluate``: the post-training evaluation of a trained or scripted agent."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Self

import tyro

from knowarm.cli.arguments import Command, answer_help, parse_options, take_option
from knowarm.cli.tables import FilePath, TableCommand, print_table
from knowarm.errors import UserError, unknown_name
from knowarm.experiment.config import EvaluationConfig, Which
from knowarm.experiment.names import task_for
from knowarm.world.agents import BLIND_AGENTS, SCRIPTED_AGENTS
from knowarm.world.config import EnvConfig
from knowarm.world.tasks import task_type

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
        return result.summary


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


def _print(summary: dict[str, Any]) -> None:
    """Print the results by target and, where they vary and are few, by target and colour."""
    title = f"{summary['agent']}: {summary['label']}"
    _print_groups(title, {"all": summary, **summary["per_target"]})
    if len(summary["per_target"]) < len(summary["per_facet"]) <= MOST_FACETS:
        _print_groups("By target and colour", summary["per_facet"])
    if "choice_chance" in summary:
        chance, reached = 100 * summary["choice_chance"], 100 * summary["success_if_chosen"]
        print(
            f"Chose the wanted object in {_share(summary, 'choice')} % of the episodes (chance "
            f"{chance:.0f} %), and reached it in {reached:.1f} % of those.\n"
        )
    if "right_object" in summary:
        print(f"Chose a part of the wanted object in {_share(summary, 'right_object')} %.\n")
    if "chose_old_answer" in summary:
        old = 100 * summary["chose_old_answer"]
        print(f"Chose what the query meant before the graph was edited in {old:.1f} %.\n")
    if "saw_no_answer" in summary:
        none, several = (100 * summary[f"saw_{each}"] for each in ("no_answer", "several_answers"))
        print(f"The agent saw no answer in {none:.1f} %, several in {several:.1f} %.\n")
    if "lift_outcomes" in summary:
        _print_lifts(summary)
    if "blind_agents" in summary:
        rows = [
            [name, numbers["episodes"], _share(numbers, "success"), _share(numbers, "difference")]
            for name, numbers in summary["blind_agents"].items()
        ]
        titles = ["blind agent", "episodes", "success %", "agent minus this, points"]
        print_table("Blind agents, on the first of these episodes", titles, rows)
        for name, entry in BLIND_AGENTS.items():
            print(f"{name}: {entry.about}.")
        seeing = "Success that depends on vision"
        if summary["needs_eyes_low"] <= 0:
            seeing = "No success is shown to depend on vision"
        print(f"{seeing}: {_share(summary, 'needs_eyes')} points.\n")
    print(
        "accuracy: distance <= {distance_m} m. success: as the task defines it, mostly with angle "
        "<= {angle_deg} deg, too. success wide: angle <= {wide_angle_deg} deg.\nfailure m: final "
        "distance of failed episodes. [95 % Wilson interval]; mean ± standard deviation.".format(
            **summary["config"]
        )
    )


def _print_lifts(summary: dict[str, Any]) -> None:
    """Print how many episodes end in a lifted object, and how the other lifts end."""
    rows = []
    for name, group in {"all": summary, **summary["per_target"]}.items():
        shares = [_share(group, share) if share in group else "-" for share in ("lifted", "grasps")]
        rows.append([name, group["lift_episodes"], *shares, *group["lift_outcomes"].values()])
    titles = ["target", "episodes", "lifted %", "grasps %", *summary["lift_outcomes"]]
    print_table("Lifts; grasps: share of the successes whose object was lifted", titles, rows)


def _print_groups(title: str, groups: dict[str, dict[str, Any]]) -> None:
    """Print one row per group of episodes."""
    rows = []
    for name, group in groups.items():
        shares = [_share(group, share) for share in ("accuracy", "success", "success_wide")]
        means = [("return", 1), ("length", 1), ("failure_distance", 3)]
        rows.append([name, group["episodes"], *shares, *(_spread(group, *each) for each in means)])
    columns = ["target", "episodes", "accuracy %", "success %", "success wide %"]
    print_table(title, [*columns, "return", "steps", "failure m"], rows)


def _share(group: dict[str, Any], name: str) -> str:
    share, low, high = (100 * group[key] for key in (name, f"{name}_low", f"{name}_high"))
    return f"{share:.1f} [{low:.0f}, {high:.0f}]"


def _spread(group: dict[str, Any], name: str, digits: int) -> str:
    mean, deviation = group[f"{name}_mean"], group[f"{name}_std"]
    return "-" if mean is None else f"{mean:.{digits}f} ± {deviation:.{digits}f}"
