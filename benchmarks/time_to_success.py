"""Environment steps and seconds of training until 80 % of the interim episodes succeed.

python -m benchmarks.time_to_success irb120-full-ppo --algorithms fast ppo --most-steps 2000000
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, cast

from knowarm.cli.tables import print_table
from knowarm.cores import available_cores
from knowarm.errors import UserError
from knowarm.experiment.algorithms import ALGORITHMS
from knowarm.experiment.config import ExperimentConfig, InterimConfig
from knowarm.experiment.names import ExperimentName, experiment_config
from knowarm.experiment.run import build, interim_evaluation
from knowarm.learn import Hooks, TorchVectorEnv, Trainer
from knowarm.learn.algorithms import MinibatchConfig
from knowarm.policy import Policy

SUCCESS = 0.8
"""Success of an interim evaluation that a learner has to reach."""

INTERIM = InterimConfig(every_steps=50_000, episodes=100)


class SuccessClock:
    """Steps and seconds until the first interim evaluation with `SUCCESS`.

    Args:
        most_steps: environment steps after which to give up.

    Attributes:
        best: highest success so far.
        steps: steps until the success; None before.
        seconds: time until the success, evaluations included; None before.
    """

    def __init__(self, most_steps: int) -> None:
        self._most_steps = most_steps
        self._start = time.perf_counter()
        self._last = 0
        self.best = 0.0
        self.steps: int | None = None
        self.seconds: float | None = None

    def add(self, step: int, success: float) -> None:
        """Take the result of an evaluation."""
        self._last, self.best = step, max(self.best, success)
        if success >= SUCCESS and self.steps is None:
            self.steps, self.seconds = step, time.perf_counter() - self._start

    def is_over(self) -> bool:
        """Tell whether the success was reached or the steps are used up."""
        return self.steps is not None or self._last >= self._most_steps

    def row(self, name: str, what: str) -> dict[str, Any]:
        """Return the row of the table; steps and seconds are None where it was not reached."""
        return {
            "name": name,
            "what": what,
            "steps": self.steps,
            "seconds": self.seconds,
            "best_success": self.best,
            "most_steps": self._most_steps,
        }


def refuse_module(experiment: ExperimentConfig) -> None:
    """Refuse agents that the benchmarks cannot train.

    Raises:
        UserError: the agent has a perception module or a grounding network.
    """
    if experiment.knows.grounding is not None:
        raise UserError(
            f"{experiment.name} has a perception module or a grounding network beside its policy, "
            "which benchmarks do not train: choose an agent without one, such as bm or full."
        )


def with_algorithm(experiment: ExperimentConfig, algorithm: str) -> ExperimentConfig:
    """Return the experiment of the same robot, task, agent and colours with another algorithm."""
    env, agent = experiment.env, experiment.agent
    return ExperimentName(
        env.robot, env.task.name, agent, env.colours, algorithm
    ).config()


def trainer_of(
    config: MinibatchConfig,
    policy: Policy,
    env: TorchVectorEnv,
    evaluate: Callable[[Policy], dict[str, float]] | None = None,
    **options: Any,
) -> Trainer:
    """Return the trainer of a config for an environment that exists."""
    make_trainer = ALGORITHMS[config.name].make_trainer
    given = {"make_env": lambda *_, **__: env, "make_evaluate": lambda: evaluate}
    return make_trainer(config, policy, **given, **options)


def time_to_success(
    experiment: ExperimentConfig,
    algorithm: str,
    *,
    most_steps: int,
    processes: int,
    seed: int,
) -> dict[str, Any]:
    """Train with a registered algorithm until `SUCCESS`; schedules extend over its usual training.

    Args:
        experiment: robot, agent and task.
        algorithm: name of the algorithm.
        most_steps: environment steps after which to give up.
        processes: of the learner.
        seed: of weights, episodes and actions.

    Returns:
        The row of `SuccessClock.row`.
    """
    refuse_module(experiment)
    chosen = with_algorithm(experiment, algorithm)
    config = replace(cast(MinibatchConfig, chosen.algorithm), processes=processes)
    parts = build(chosen)
    knowledge = parts.knowledge
    env = knowledge.make_env(chosen.env, config.num_envs, num_threads=processes)
    clock = SuccessClock(most_steps)
    trainer = trainer_of(
        config,
        parts.new_policy(seed),
        env,
        seed=seed,
        make_evaluate=lambda: interim_evaluation(
            chosen.env, INTERIM, partial(knowledge.make_agent, greedy=True)
        ),
        evaluate_every=INTERIM.every_steps,
        hooks=Hooks(
            on_evaluation=lambda step, results, _: clock.add(step, results["success"]),
            should_stop=clock.is_over,
        ),
    )
    trainer.train(ALGORITHMS[algorithm].total_steps)
    return clock.row(algorithm, f"KnowArm, {ALGORITHMS[algorithm].about}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("experiment")
    parser.add_argument("--algorithms", nargs="+", required=True)
    parser.add_argument("--most-steps", type=int, default=2_000_000)
    parser.add_argument("--processes", type=int, default=available_cores())
    parser.add_argument("--seed", type=int, default=0)
    options = vars(parser.parse_args())
    experiment = experiment_config(options.pop("experiment"))
    algorithms = options.pop("algorithms")
    rows = [time_to_success(experiment, name, **options) for name in algorithms]
    print_table(
        f"Until {SUCCESS:.0%} success",
        list(rows[0]),
        [list(row.values()) for row in rows],
    )


if __name__ == "__main__":
    main()
