"""``knowarm train`` and ``knowarm demo``: training runs."""

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import tyro

from knowarm.cli.knowledge.options import take_source
from knowarm.cli.tables import FilePath
from knowarm.errors import UserError
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.demo import STEPS, demo
from knowarm.experiment.registry import DEFAULT_EXPERIMENT, experiment_config, experiment_names
from knowarm.experiment.run import run_path, train
from knowarm.experiment.run_folder import RunFolder
from knowarm.experiment.stop_request import StopRequest
from knowarm.report import write_report

USAGE = f"""usage: knowarm train EXPERIMENT [OPTIONS]

Train one agent, or resume a stopped run.

EXPERIMENT is one of the names ROBOT-AGENT[-dr]-ALGORITHM that `knowarm list` explains, such as
{DEFAULT_EXPERIMENT}. Its options have that experiment's values as defaults:
  knowarm train {DEFAULT_EXPERIMENT} --help"""


@dataclass(frozen=True, kw_only=True)
class Train:
    """Train one agent, or resume a stopped run."""

    config: Annotated[ExperimentConfig, tyro.conf.arg(name="")]
    runs: Path = Path("runs")
    """Parent folder of all runs; this run is saved in RUNS/EXPERIMENT/SEED."""
    resume: bool = False
    """Resume the run from its latest checkpoint, with the options it was started with."""
    perception: FilePath = None
    """Perception module of `knowarm perception train`, for agents told what is perceived."""

    def run(self) -> None:
        """Train until the last step or Ctrl-C."""
        with StopRequest() as should_stop:
            run = train(
                self.config,
                self.runs,
                resume=self.resume,
                should_stop=should_stop,
                perception=self.perception,
            )
        where, result = run.folder.path, run.result
        if result.reason == "stopped":
            again = f"knowarm train {self.config.name} --seed {self.config.seed} --resume"
            again += "" if self.runs == Path("runs") else f" --runs {self.runs}"
            print(f"Stopped at step {result.step:,} and saved. Resume with: {again}")
            return
        print(f"Trained for {result.step:,} steps: {where}")
        if result.best_return is not None:
            print(
                f"Best interim evaluation: return {result.best_return:.1f} at step "
                f"{result.best_step:,}"
            )
        print(f"Evaluate it with: knowarm evaluate {where}")


def parse_train(arguments: list[str]) -> Train:
    """Parse the arguments of ``train``.

    The experiment's name is read first: the other arguments override the values of that
    experiment, or with ``--resume`` the values stored in the run folder.
    """
    if not arguments or arguments[0] in ("-h", "--help"):
        print(USAGE)
        sys.exit(0)
    name, *rest = arguments
    if name.startswith("-"):
        raise UserError(
            f"The first argument must be the name of an experiment, got {name}. There are "
            f"{len(experiment_names())}; `knowarm list` explains their names."
        )
    command = _parse_options(name, rest, experiment_config(name))
    if command.resume:
        stored = RunFolder.open(run_path(command.runs, command.config)).experiment()
        command = _parse_options(name, rest, stored)
    return command


def _parse_options(name: str, arguments: list[str], config: ExperimentConfig) -> Train:
    """Parse the options over a config; `--knowledge.source` also takes the name of a source."""
    arguments, source = take_source(arguments, "--knowledge.source")
    if source is not None:
        config = replace(config, knowledge=replace(config.knowledge, source=source))
    return tyro.cli(
        Train,
        prog=f"knowarm train {name}",
        args=arguments,
        default=Train(config=config),
        config=(tyro.conf.AvoidSubcommands,),  # the experiment fixes the algorithm
    )


@dataclass(frozen=True, kw_only=True)
class Demo:
    """Train a baseline and a knowledge agent for a short time, evaluate both, write a report."""

    out: Path = Path("runs/demo")
    """Folder of the two runs and of report.html."""
    steps: int = STEPS
    """Environment steps per agent."""

    def run(self) -> None:
        """Run the demo."""
        with StopRequest() as should_stop:
            runs = demo(self.out, steps=self.steps, should_stop=should_stop)
        if runs is None:
            print("Stopped and saved. Run the same command again to resume.")
        else:
            path = write_report(runs, self.out / "report.html")
            print(f"Wrote {path}: open it in a browser.")
