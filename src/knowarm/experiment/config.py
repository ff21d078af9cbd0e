"""Configuration of a training run (``config.json`` of its folder) and of an evaluation."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Literal

from knowarm.config import check_values, file_name, registered
from knowarm.errors import UserError
from knowarm.experiment.agents import Role
from knowarm.experiment.algorithms import algorithms
from knowarm.experiment.knows import Knows, fits
from knowarm.learn.algorithms import AlgorithmConfig, PPOConfig, SeenConfig
from knowarm.policy.config import PolicyConfig
from knowarm.world.config import EnvConfig

Which = Literal["best", "latest", "untrained"]
"""Policy of a run: of the best interim evaluation, the latest, or the initial weights."""
INTERIM_SEED = 20_250_714
"""Seed of the episodes of interim evaluations: that of all experiments, so that their curves are
comparable."""
MIN_EVALUATIONS = 10
"""Least number of interim evaluations that are spread over a training."""


@dataclass(frozen=True, kw_only=True)
class InterimConfig:
    """The evaluation at regular intervals during training (paper section 4.2.3).

    It takes the most probable actions.
    """

    every_steps: int = 50_000
    """Most environment steps between two interim evaluations; a tenth of a shorter training."""
    episodes: int = 40
    """Episodes per evaluation; always the same ones."""

    def __post_init__(self) -> None:
        check_values(self, where="interim")


@dataclass(frozen=True, kw_only=True)
class StopWhen:
    """A rule that ends training before its last step."""

    success: float
    """Success of interim evaluations that counts as learned, 0 to 1."""
    evaluations: int = 3
    """Consecutive interim evaluations with at least that success that end the training."""

    def __post_init__(self) -> None:
        check_values(self, where="stop_when")

    def met_at(self, curve: Iterable[tuple[int, float]]) -> int | None:
        """Return the step at which a curve of step and success meets the rule, or None."""
        count = 0
        for step, success in curve:
            count = count + 1 if success >= self.success else 0
            if count == self.evaluations:
                return step
        return None


@dataclass(frozen=True, kw_only=True)
class ExperimentConfig:
    """One training run: environment, knowledge, policy network and learning algorithm."""

    name: str
    """Name of the experiment; its runs are stored in ``<runs>/<name>/<seed>/``."""
    agent: str
    """Name of the agent in tables and reports."""
    algorithm_name: str = ""
    """Name of the algorithm in tables and reports, as in `knowarm list`; ``algorithm`` has its
    hyperparameters. Empty: the name of its trainer."""
    role: Role = "knowledge"
    """Purpose of the agent in a comparison, by which reports choose what to compare it with."""
    seed: int = 0
    """Seed of initial weights, episodes, actions and minibatches."""
    total_steps: int = 10_000_000
    """Environment steps to train for, over all environments (the paper: 70 million)."""
    checkpoint_every_steps: int = 200_000
    """Environment steps between two checkpoints: the most that a crash can lose."""
    env: EnvConfig = field(default_factory=EnvConfig)
    """Robot, targets, colours, dynamics and success thresholds."""
    knows: Knows
    """What the agent knows, and what computes it."""
    policy: PolicyConfig = field(default_factory=PolicyConfig)
    """Choices of the policy network."""
    algorithm: AlgorithmConfig = field(
        default_factory=PPOConfig,
        metadata=registered(
            lambda: [type(e.config) for e in algorithms().values()], "algorithm"
        ),
    )
    """The learning algorithm and its hyperparameters."""
    interim: InterimConfig = field(default_factory=InterimConfig)
    """The evaluation at regular intervals during training."""
    stop_when: StopWhen | None = None
    """End training before ``total_steps`` once this rule is met; None trains all steps."""

    def __post_init__(self) -> None:
        check_values(self)
        file_name(self, "name")
        if not fits(self.knows, self.env.task):
            raise UserError(
                f"Knowledge of the kind {self.knows.kind!r} describes nothing in the task "
                f"{self.env.task.name!r}. Take another agent or task."
            )

    @property
    def solves(self) -> bool:
        """Whether inverse kinematics act in place of a policy."""
        return isinstance(self.algorithm, SeenConfig)

    @property
    def evaluate_every(self) -> int:
        """Environment steps between two interim evaluations, of which there are ten or more."""
        tenth = max(1, self.total_steps // MIN_EVALUATIONS)
        return min(self.interim.every_steps, tenth)

    @property
    def learner(self) -> str:
        """Name of the algorithm in the registry, or of its trainer if it has none."""
        entry = algorithms().get(self.algorithm_name)
        if entry and entry.config.name == self.algorithm.name:
            return self.algorithm_name
        return self.algorithm.name
