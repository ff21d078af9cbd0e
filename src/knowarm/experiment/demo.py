"""Demo study: a baseline and a knowledge agent, trained for a small budget and evaluated."""

from collections.abc import Callable
from pathlib import Path

from knowarm.errors import UserError
from knowarm.experiment.agents import first_of_role
from knowarm.experiment.algorithms import DEMO_ALGORITHM
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.evaluation import EvaluationConfig
from knowarm.experiment.names import experiment_config
from knowarm.world.robots import DEMO_ROBOT

STEPS = 80_000
"""Environment steps of each agent."""
EVALUATION = EvaluationConfig(episodes=200, label="demo")


def demo(
    folder: Path,
    *,
    steps: int = STEPS,
    should_stop: Callable[[], bool],
) -> list[Path] | None:
    """Train, resume and evaluate both agents; return the run folders, or None if stopped."""
    # Imports torch, which takes seconds
    from knowarm.experiment.evaluate import (
        evaluate,
    )
    from knowarm.experiment.load import load_agent
    from knowarm.experiment.run import run_path, train
    from knowarm.experiment.run_folder import RunFolder

    paths = []
    for config in demo_experiments(steps):
        path = run_path(folder, config)
        is_started = (path / "config.json").exists()
        if is_started:
            old = RunFolder.open(path).experiment().total_steps
            if old != steps:
                problem = f"{folder} holds a demo of {old} steps, got {steps}"
                raise UserError(
                    f"{problem}. Continue it with {old} steps, or give another folder."
                )
        run = train(config, folder, resume=is_started, should_stop=should_stop)
        if run.result.reason == "stopped":
            return None
        paths.append(run.folder.path)
        evaluate(run, config=EVALUATION)
        evaluate(load_agent(run.folder.path, which="untrained"), config=EVALUATION)
        if should_stop():
            return None
    return paths


def demo_experiments(steps: int) -> list[ExperimentConfig]:
    """Return the experiments of the demo: baseline and knowledge, with the demo's algorithm."""
    configs = []
    for role in ("baseline", "knowledge"):
        name = f"{DEMO_ROBOT}-{first_of_role(role)}-{DEMO_ALGORITHM}"
        configs.append(experiment_config(name, total_steps=steps))
    return configs
