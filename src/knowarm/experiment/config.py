"""All choices of one experiment, resolved: what ``config.json`` of a run folder holds."""

from dataclasses import dataclass, field
from typing import Literal

from knowarm.errors import UserError
from knowarm.knowledge.config import KnowledgeConfig
from knowarm.learn.config import A3CConfig, PPOConfig
from knowarm.world.config import EnvConfig

Algorithm = PPOConfig | A3CConfig


@dataclass(frozen=True, kw_only=True)
class NetworkConfig:
    """The choices of a policy that do not follow from the robot, the image or the knowledge."""

    fusion: str = "before_lstm"
    """Where the knowledge enters; ``before_lstm`` is the paper's. An agent without knowledge
    ignores it."""

    hidden: Literal["grow", "fixed"] | int = "grow"
    """LSTM size: ``grow`` adds the knowledge's width to ``features`` (the paper's 128 / 278 /
    428), ``fixed`` keeps ``features``, or a number."""

    features: int = 128
    """Width of the fully connected layer after the convolutions."""

    wide: bool = False
    """Capacity control: the knowledge is taken away, and the network is given the same LSTM size
    and number of parameters that it would have had with it."""

    pixel_shift: float = 0.0
    """Subtracted from the pixels after they were scaled to 0..1."""

    pixel_scale: float = 1.0
    """Multiplies the shifted pixels; .5 and 4 give images mean 0 and deviation about 1."""

    actor_gain: float = 0.01
    """Gain of the orthogonal initialization of the actor heads."""


@dataclass(frozen=True, kw_only=True)
class InterimConfig:
    """The evaluation that goes on beside the training (paper section 4.2.3)."""

    every_steps: int = 50_000
    """Environment steps between two interim evaluations."""

    episodes: int = 40
    """Episodes of each; the same ones every time."""

    greedy: bool = True
    """Whether the most probable action is taken instead of a drawn one."""

    seed: int = 20_250_714
    """Seed of the episodes; the same for every experiment, so that curves can be compared."""

    def __post_init__(self) -> None:
        for name in ("every_steps", "episodes"):
            if getattr(self, name) < 1:
                raise UserError(f"interim.{name} must be at least 1, got {getattr(self, name)}.")


@dataclass(frozen=True, kw_only=True)
class ExperimentConfig:
    """One training run: a world, what is known about it, a network and how it learns."""

    name: str
    """Name of the experiment; its runs lie in ``runs/<name>/<seed>/``."""

    agent: str
    """Name of the agent, as in the paper's tables and the reports."""

    seed: int = 0
    """Seed of weights, episodes, actions and minibatches."""

    total_steps: int = 10_000_000
    """Environment steps to train for, over all environments (the paper: 70 million)."""

    checkpoint_every_steps: int = 200_000
    """Environment steps between two checkpoints: what a crash can cost at most."""

    env: EnvConfig = field(default_factory=EnvConfig)
    """Robot, targets, colours, dynamics and success thresholds."""

    knowledge: KnowledgeConfig
    """What the agent is told about the targets."""

    network: NetworkConfig = field(default_factory=NetworkConfig)
    """Choices of the policy network."""

    algorithm: Algorithm = field(default_factory=PPOConfig)
    """PPO or A3C with all of its numbers."""

    interim: InterimConfig = field(default_factory=InterimConfig)
    """The evaluation beside the training."""

    def __post_init__(self) -> None:
        for name in ("total_steps", "checkpoint_every_steps"):
            if getattr(self, name) < 1:
                raise UserError(f"{name} must be at least 1, got {getattr(self, name)}.")
        if self.seed < 0:
            raise UserError(f"seed must be 0 or more, got {self.seed}.")
