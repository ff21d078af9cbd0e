"""``knowarm train``: a name and overrides go in; a run folder comes out."""

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import tyro

from knowarm.cli.knowledge.options import take_source
from knowarm.errors import UserError
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.registry import experiment_config, experiment_names
from knowarm.experiment.run import StopRequest, run_path, train
from knowarm.experiment.run_folder import RunFolder

USAGE = """usage: knowarm train NAME [options]

NAME is an experiment, ROBOT-AGENT[-dr]-ALGORITHM (see `knowarm list`), such as irb120-full-ppo.
`knowarm train NAME --help` shows every option with its value in that experiment."""


@dataclass(frozen=True, kw_only=True)
class Train:
    """Train one agent, or go on with a stopped run."""

    config: Annotated[ExperimentConfig, tyro.conf.arg(name="")]
    runs: Path = Path("runs")
    """Folder of all runs; this one becomes RUNS/<experiment>/<seed>."""
    resume: bool = False
    """Go on from the run's latest checkpoint."""

    def run(self) -> None:
        """Train until the end or Ctrl-C."""
        with StopRequest() as should_stop:
            run = train(self.config, self.runs, resume=self.resume, should_stop=should_stop)
        where, result = run.folder.path, run.result
        if result.reason == "stopped":
            again = f"knowarm train {self.config.name} --seed {self.config.seed} --resume"
            again += "" if self.runs == Path("runs") else f" --runs {self.runs}"
            print(f"Stopped at step {result.step:,} and saved. Go on with: {again}")
            return
        print(f"Trained for {result.step:,} steps: {where}")
        if result.best_return is not None:
            print(
                f"Best interim evaluation: return {result.best_return:.1f} at {result.best_step:,}"
            )
        print(f"Evaluate it with: knowarm evaluate {where}")


def parse(arguments: list[str]) -> Train:
    """Read the name first: the options' values are those of that experiment, or of the run."""
    if not arguments or arguments[0] in ("-h", "--help"):
        print(USAGE)
        sys.exit(0)
    name, *rest = arguments
    if name.startswith("-"):
        raise UserError(f"The first word must be the experiment's name, got {name}. {USAGE_HINT}")
    command = _options(name, rest, experiment_config(name))
    if command.resume:
        # The run began with its own overrides; only what is typed now may differ from them.
        stored = RunFolder.open(run_path(command.runs, command.config)).experiment()
        command = _options(name, rest, stored)
    return command


def _options(name: str, arguments: list[str], config: ExperimentConfig) -> Train:
    arguments, source = take_source(arguments, "--knowledge.source")
    if source is not None:
        config = replace(config, knowledge=replace(config.knowledge, source=source))
    return tyro.cli(
        Train,
        prog=f"knowarm train {name}",
        args=arguments,
        default=Train(config=config),
        config=(tyro.conf.AvoidSubcommands,),  # the name has chosen the algorithm
    )


USAGE_HINT = f"There are {len(experiment_names())}; `knowarm list` shows how they are named."
