"""Configuration of one experiment: the content of ``config.json`` in a run folder."""

from dataclasses import dataclass, field

from knowarm.config import registered
from knowarm.errors import UserError
from knowarm.experiment.agents import Role
from knowarm.experiment.algorithms import ALGORITHMS
from knowarm.knowledge.config import KnowledgeConfig
from knowarm.learn.config import AlgorithmConfig, PPOConfig
from knowarm.policy.config import PolicyConfig
from knowarm.world.config import EnvConfig


@dataclass(frozen=True, kw_only=True)
class InterimConfig:
    """The evaluation at regular intervals during training (paper section 4.2.3)."""

    every_steps: int = 50_000
    """Environment steps between two interim evaluations."""

    episodes: int = 40
    """Episodes per evaluation; always the same ones."""

    greedy: bool = True
    """Take the most probable action instead of sampling one."""

    seed: int = 20_250_714
    """Seed of the episodes; the same for every experiment, so that curves are comparable."""

    def __post_init__(self) -> None:
        for name in ("every_steps", "episodes"):
            if getattr(self, name) < 1:
                raise UserError(f"interim.{name} must be at least 1, got {getattr(self, name)}.")


@dataclass(frozen=True, kw_only=True)
class ExperimentConfig:
    """One training run: environment, knowledge, policy network and learning algorithm.

    Raises:
        UserError: a value out of its range.
    """

    name: str
    """Name of the experiment; its runs are stored in ``<runs>/<name>/<seed>/``."""

    agent: str
    """Name of the agent in tables and reports."""

    role: Role = "knowledge"
    """What the agent is for in a comparison of agents: see `knowarm.experiment.agents.Role`."""

    seed: int = 0
    """Seed of initial weights, episodes, actions and minibatches."""

    total_steps: int = 10_000_000
    """Environment steps to train for, over all environments (the paper: 70 million)."""

    checkpoint_every_steps: int = 200_000
    """Environment steps between two checkpoints: the most that a crash can lose."""

    env: EnvConfig = field(default_factory=EnvConfig)
    """Robot, targets, colours, dynamics and success thresholds."""

    knowledge: KnowledgeConfig
    """From the graph to the agent's knowledge vector."""

    policy: PolicyConfig = field(default_factory=PolicyConfig)
    """Choices of the policy network."""

    algorithm: AlgorithmConfig = field(
        default_factory=PPOConfig,
        metadata=registered(lambda: [type(entry.config) for entry in ALGORITHMS.values()]),
    )
    """The learning algorithm and its hyperparameters."""

    interim: InterimConfig = field(default_factory=InterimConfig)
    """The evaluation at regular intervals during training."""

    def __post_init__(self) -> None:
        for name in ("total_steps", "checkpoint_every_steps"):
            if getattr(self, name) < 1:
                raise UserError(f"{name} must be at least 1, got {getattr(self, name)}.")
        if self.seed < 0:
            raise UserError(f"seed must be 0 or more, got {self.seed}.")
