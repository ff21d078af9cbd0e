"""Registry of learning algorithms: default config, trainer and training length of each."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, cast

import numpy as np

from knowarm.learn.a3c import A3CTrainer
from knowarm.learn.config import A3CConfig, AlgorithmConfig, PPOConfig
from knowarm.learn.evaluator import MakeEvaluate
from knowarm.learn.ppo import PPOTrainer
from knowarm.learn.trainer import TrainingResult
from knowarm.policy import Policy


class Trainer(Protocol):
    """What `run.train` needs of a trainer."""

    step: int

    def train(self, total_steps: int) -> TrainingResult:
        """Train until ``total_steps`` environment steps were taken in total."""
        ...

    def resume(self) -> None:
        """Restore the latest checkpoint."""
        ...


class MakeEnv(Protocol):
    """Picklable factory of vector environments of one task."""

    def __call__(self, num_envs: int, num_threads: int = 0, *, device: str = "cpu") -> Any:
        """Make ``num_envs`` environments on a device, with ``num_threads`` threads (0: all)."""
        ...


@dataclass(frozen=True, kw_only=True)
class TrainerInputs:
    """Everything a trainer is built from."""

    config: AlgorithmConfig
    """Hyperparameters: an instance of the type of ``Algorithm.config``."""
    policy: Policy
    """The policy to train in place."""
    knowledge: np.ndarray
    """(F, K) float32 knowledge table, one row per facet of the environment."""
    make_env: MakeEnv
    """Makes the training environments."""
    make_evaluate: MakeEvaluate
    """Makes the interim evaluation; picklable, so that another process can call it."""
    options: Mapping[str, Any]
    """Keyword arguments shared by all trainers: ``seed``, ``evaluate_every``, ``hooks``,
    ``checkpoints``, ``checkpoint_every``, ``failure_folder``."""


@dataclass(frozen=True, kw_only=True)
class Algorithm:
    """One learning algorithm and the defaults of its experiments."""

    about: str
    """One line for ``knowarm list``."""
    config: AlgorithmConfig
    """Default hyperparameters. Its first field is a literal ``name`` equal to the registry's."""
    make_trainer: Callable[[TrainerInputs], Trainer]
    """Builds a trainer; it has a ``step``, ``train(total_steps)`` and ``resume()``."""
    total_steps: int
    """Environment steps of an experiment, over all environments."""
    policy: Mapping[str, Any] = field(default_factory=dict)
    """Fields of the policy's config that differ from their defaults under this algorithm."""


def _make_ppo(inputs: TrainerInputs) -> PPOTrainer:
    config = cast(PPOConfig, inputs.config)
    env = inputs.make_env(config.num_envs, device=config.device)
    if config.device == "cpu":
        evaluation: dict[str, Any] = {"evaluate": inputs.make_evaluate()}
    else:
        # The interim episodes are played on the CPU: on a GPU they would take as long as training.
        evaluation = {"make_evaluate": inputs.make_evaluate}
    return PPOTrainer(config, inputs.policy, env, inputs.knowledge, **evaluation, **inputs.options)


def _make_a3c(inputs: TrainerInputs) -> A3CTrainer:
    return A3CTrainer(
        cast(A3CConfig, inputs.config),
        inputs.policy,
        inputs.make_env,
        inputs.knowledge,
        make_evaluate=inputs.make_evaluate,
        **inputs.options,
    )


ALGORITHMS: dict[str, Algorithm] = {
    "ppo": Algorithm(
        about="recurrent proximal policy optimization; on CPU or GPU",
        config=PPOConfig(),
        make_trainer=_make_ppo,
        total_steps=10_000_000,
        policy={"pixel_shift": 0.5, "pixel_scale": 4.0},
    ),
    "a3c": Algorithm(
        about="asynchronous advantage actor-critic with the paper's numbers; on CPU",
        config=A3CConfig(),
        make_trainer=_make_a3c,
        total_steps=70_000_000,
        policy={"pixel_shift": 0.0, "pixel_scale": 1.0},
    ),
}
"""Every algorithm by name; the first is the demo's."""
