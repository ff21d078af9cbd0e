"""Nothing but a folder goes in; two small trained agents and a report about them come out."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

from knowarm.experiment.config import ExperimentConfig, InterimConfig
from knowarm.experiment.evaluate import EvaluationConfig, evaluate
from knowarm.experiment.load import Which, load_agent
from knowarm.experiment.registry import experiment
from knowarm.experiment.run import run_path, train
from knowarm.experiment.run_folder import RunFolder
from knowarm.report import report

AGENTS = ("bm", "full")
"""The agents compared: no knowledge, and object types with colours."""

STEPS = 500_000
"""Environment steps each agent is trained for: enough to learn the orientation, not the task."""

JUDGED = EvaluationConfig(episodes=200, label="demo")
"""The same 200 episodes for everybody."""


def demo(folder: Path, *, steps: int = STEPS, should_stop: Callable[[], bool]) -> Path | None:
    """Train both agents, evaluate them and an untrained policy, and write the report.

    What an earlier demo in the same folder has already trained is not trained again; what it
    began is gone on with.

    Args:
        folder: of the runs and the report.
        steps: environment steps for each agent.
        should_stop: asked between updates; true saves and ends the demo.

    Returns:
        the report, or None when stopped before.
    """
    paths = []
    for config in demo_experiments(steps):
        path = run_path(folder, config)
        is_begun = (path / "config.json").exists()
        run = train(config, folder, resume=is_begun, should_stop=should_stop)
        if run.result.reason == "stopped":
            return None
        paths.append(run.folder.path)
        _evaluate(run.folder, "best")
        _evaluate(run.folder, "untrained")
    return report(paths, folder / "report.html")


def demo_experiments(steps: int) -> list[ExperimentConfig]:
    """The experiments of the demo: the shipped ones, but shorter."""
    return [
        dataclasses.replace(
            experiment(f"irb120-{agent}-ppo"),
            total_steps=steps,
            interim=InterimConfig(every_steps=max(1, steps // 10)),
        )
        for agent in AGENTS
    ]


def _evaluate(folder: RunFolder, which: Which) -> None:
    label = JUDGED.folder if which == "best" else f"{JUDGED.folder}-{which}"
    trained = load_agent(folder.path, which=which)
    judged = dataclasses.replace(JUDGED, label=label)
    evaluate(trained.agent, trained.config.env, judged, agent_name=trained.config.agent).write(
        folder.evaluation(label)
    )
