"""``knowarm train`` and ``demo``: training.

What imports torch, which takes seconds, is imported after the options are read.
"""

import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from tyro.conf import Suppress, arg

from knowarm.cli.arguments import (
    HELP,
    OWN,
    answer_help,
    parse_options,
    take_option,
    take_source,
)
from knowarm.cli.tables import FilePath
from knowarm.config import flatten, override, to_dict
from knowarm.errors import UserError, shell_command
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.demo import STEPS, demo
from knowarm.experiment.names import (
    DEFAULT_EXPERIMENT,
    ExperimentName,
    check_graphs,
    override_experiment,
)
from knowarm.experiment.run_lock import StopRequest
from knowarm.own import named_by
from knowarm.reading import read_json, read_toml
from knowarm.world.tasks import find_task

USAGE = f"""usage: knowarm train EXPERIMENT [OPTIONS]

Train one agent, or resume a stopped run.

EXPERIMENT is one of the names ROBOT-AGENT[-dr]-ALGORITHM that `knowarm list` explains, such as
{DEFAULT_EXPERIMENT}. For a robot of your own leave out ROBOT and give --env.robot my_arm.toml.
Its options have that experiment's values as defaults:
  knowarm train {DEFAULT_EXPERIMENT} --help             the ten options that matter first
  knowarm train {DEFAULT_EXPERIMENT} --help knows       a group of options
  knowarm train {DEFAULT_EXPERIMENT} --help-all         all options
  knowarm train {DEFAULT_EXPERIMENT} --config run.toml  options from a file"""
FIRST = (
    "runs",
    "resume",
    "config.name",
    "config.seed",
    "config.total_steps",
    "config.env.robot",
    "config.env.targets",
    "config.env.colours",
    "graph",
    "config.algorithm.learning_rate",
)
"""The options that `--help` shows."""


@dataclass(frozen=True, kw_only=True)
class Train:
    """Train one agent, or resume a stopped run."""

    config: Annotated[ExperimentConfig, arg(name="")]
    runs: Path = Path("runs")
    """Parent folder of all runs; this run is saved in RUNS/EXPERIMENT/SEED."""
    resume: bool = False
    """Resume the run from its latest checkpoint, with the options it was started with."""
    graph: Annotated[str | None, arg(metavar="FILE")] = None
    """Graph of the knowledge and the questions: a file, or the name of a shipped one."""
    until_step: Annotated[int | None, arg(metavar="N")] = None
    """Save and end at step N of all; resuming goes on to the last step, or to another N."""
    perception: FilePath = None
    """perception.safetensors of another run, for agents that would train such a network first."""
    again: Suppress[str] = ""
    """The command that resumes this run."""
    own: Suppress[str] = ""
    """Options by which evaluations find a task and an algorithm of one's own."""

    @classmethod
    def parse(cls, prog: str, arguments: Sequence[str]) -> "Train":
        """Parse the options over the values of the experiment, or those of the run to resume."""
        name, words = _take_name(arguments)
        words, file = take_option(words, "--config", "run.toml")
        values = {} if file is None else read_toml(Path(file))
        words, task = take_option(words, "--env.task", "package.module:Name")
        words, robot = take_option(words, "--env.robot", "my_arm.toml")
        words, graph = take_option(words, "--graph", "kitchen.csv")
        words, source = take_source(words, "--knows.source")
        experiment = ExperimentName.parse(name)
        if task is not None:
            base = find_task(experiment.task)
            chosen = find_task(task, base)
            experiment = replace(experiment, task=chosen.name)
            values["env"] = {"task": chosen.changes()} | values.get("env", {})
        if robot is not None:
            values["env"] = {**values.get("env", {}), "robot": robot}
        if graph is not None:
            values["graph"] = graph
        config = experiment.config(**values)
        prog = f"{prog} {name}"
        words = answer_help(cls(config=config), prog, words, FIRST)

        def parse_over(config: ExperimentConfig) -> "Train":
            if source is not None:
                config = override(config, {"knows": {"source": to_dict(source)}})
            return parse_options(cls, prog, words, default=cls(config=config))

        command = parse_over(config)
        if command.resume:
            from knowarm.experiment.run import run_path
            from knowarm.experiment.run_folder import RunFolder

            path = run_path(command.runs, command.config)
            if not path.exists():
                raise UserError(
                    f"There is no run to resume in {path}: leave out --resume."
                )
            started = RunFolder.open(path).experiment()
            command = parse_over(override_experiment(started, values))
        else:
            set_fields = list(flatten(values))
            for word in words:
                option = word.partition("=")[0]
                set_fields.append(option.lstrip("-").replace("-", "_"))
            check_graphs(command.config, set_fields)
        own = ""
        for flag, (variable, _) in OWN.items():
            import_paths = named_by(variable)
            if import_paths:
                own += f" {flag} {shlex.quote(import_paths[-1])}"
        others, _ = take_option(arguments, "--until-step", "N")
        again = shell_command("train", *others)
        if not command.resume:
            again += " --resume"
        return replace(command, again=again + own, own=own)

    def run(self) -> int:
        """Train until the last step or Ctrl-C; return the exit code."""
        from knowarm.experiment.run import train

        with StopRequest() as should_stop:
            run = train(
                self.config,
                self.runs,
                resume=self.resume,
                should_stop=should_stop,
                perception=self.perception,
                until_step=self.until_step,
            )
        path = run.folder.path
        result = run.result
        step = f"{result.step:,}"
        if result.reason == "stopped":
            if self.until_step is not None and result.step >= self.until_step:
                total = f"{self.config.total_steps:,}"
                print(f"Paused at step {step} of {total} and saved: {path}")
                print(f"Resume with: {self.again}")
                return 0
            print(f"Stopped at step {step} and saved. Resume with: {self.again}")
            return 130
        print(f"Trained for {step} steps: {path}")
        if result.best_return is not None:
            best = read_json(run.folder.checkpoints / "best" / "meta.json")
            print(
                f"Best interim evaluation: success {100 * best['facts']['success']:.0f} %, "
                f"return {result.best_return:.1f}, at step {result.best_step:,}"
            )
            if result.best_step == 0:
                print("That is the untrained network: none after it was better.")
        print(f"Evaluate it with: {shell_command('evaluate', path)}{self.own}")
        print(f"Compare runs with: {shell_command('report', self.runs)}{self.own}")
        return 0


def _take_name(arguments: Sequence[str]) -> tuple[str, list[str]]:
    """Return the name of the experiment, which comes first, and the other words.

    Without a name the usage is printed and the process ends.
    """
    if not arguments or arguments[0] in HELP:
        print(USAGE, file=sys.stdout if arguments else sys.stderr)
        sys.exit(0 if arguments else 2)
    name, *words = arguments
    if name.startswith("-"):
        raise UserError(
            f"The first argument must be the name of an experiment, got {name}; `knowarm list` "
            "explains their names."
        )
    return name, words


@dataclass(frozen=True, kw_only=True)
class Demo:
    """Train a baseline and a knowledge agent for a short time, evaluate both, write a report."""

    out: Path = Path("runs/demo")
    """Folder of the two runs and of report.html."""
    steps: int = STEPS
    """Environment steps per agent."""

    def run(self) -> int:
        """Run the demo; return the exit code."""
        from knowarm.report import write_report

        print(
            f"Trains two agents for {self.steps:,} steps each, evaluates them, writes a report."
        )
        with StopRequest() as should_stop:
            runs = demo(self.out, steps=self.steps, should_stop=should_stop)
        if runs is None:
            print("Stopped and saved. Run the same command again to resume.")
            return 130
        path = write_report(runs, self.out / "report.html")
        print(f"Wrote {path}: open it in a browser.")
        return 0
