"""Choices of a learning algorithm go in; checked, frozen configs come out."""

from dataclasses import dataclass
from typing import Literal

from knowarm.errors import UserError


class AlgorithmConfig:
    """Base class of the algorithms' configs, whose first field is a literal ``name``."""

    name: str


@dataclass(frozen=True, kw_only=True)
class PPOConfig(AlgorithmConfig):
    """Recurrent PPO; the defaults are what learned fastest (docs/lab-notes.md).

    Raises:
        UserError: a value out of its range, or minibatches that do not divide the environments.
    """

    name: Literal["ppo"] = "ppo"
    """Tells this config from the other algorithms' in a file."""

    num_envs: int = 128
    """Environments stepped together."""

    rollout_steps: int = 25
    """Steps of each environment between two updates."""

    epochs: int = 2
    """Passes over each rollout."""

    minibatches: int = 4
    """Parts the environments are divided into; each part is one gradient step a pass."""

    learning_rate: float = 1e-3
    """Adam's step size at the start."""

    learning_rate_schedule: Literal["constant", "linear", "cosine"] = "linear"
    """How the step size falls over the whole training."""

    learning_rate_final: float = 0.1
    """Step size at the end, as a share of the one at the start."""

    adam_epsilon: float = 1e-5
    """Adam's guard against division by zero."""

    gamma: float = 0.95
    """Discount factor. The paper's A3C has .99; with .95 three times as many episodes succeeded
    after 600,000 steps, since a reach takes 5 to 16 steps (docs/lab-notes.md)."""

    gae_lambda: float = 0.95
    """Lambda of the advantage estimate."""

    clip_range: float = 0.2
    """How far the probability ratio counts."""

    vf_coef: float = 0.5
    """Weight of the value loss."""

    ent_coef: float = 0.003
    """Weight of the entropy [1/nat]; the policies under docs/results learned with it."""

    reward_scale: float = 0.05
    """Multiplies every reward before learning; reported returns are not scaled."""

    normalize_advantages: bool = True
    """Shift and scale the advantages of a rollout to mean 0, deviation 1."""

    max_grad_norm: float = 0.5
    """Longer gradients are shortened to this norm."""

    target_kl: float | None = None
    """Stop the passes over a rollout when the policy has moved this far [nat]; None never."""

    device: Literal["cpu", "cuda"] = "cpu"
    """Where physics, images and learning happen; "cuda" keeps all of it on one GPU."""

    matmul_precision: Literal["auto", "float32", "tf32", "bfloat16"] = "auto"
    """Of the products in encoder and LSTM while training: ``auto`` takes bfloat16 where the
    device computes it, else float32; "tf32" is a GPU's. Parameters, cell, heads and losses are
    float32 always."""

    processes: int | None = None
    """Processes that share the network's work on the CPU, one thread each; None takes one a core,
    and never more than every eighth environment of a minibatch. Another number rounds sums
    differently."""

    cuda_graphs: bool = True
    """Launch the kernels of a gradient step as one (device "cuda")."""

    def __post_init__(self) -> None:
        _at_least(
            self,
            1,
            "num_envs",
            "rollout_steps",
            "epochs",
            "minibatches",
            *_given(self, "processes"),
        )
        _positive(
            self, "learning_rate", "adam_epsilon", "clip_range", "reward_scale", "max_grad_norm"
        )
        _share(self, "gamma", "gae_lambda", "learning_rate_final")
        if self.device == "cuda" and self.processes is not None:
            raise UserError(
                f"processes ({self.processes}) share the work on device 'cpu'; leave it out with "
                "device 'cuda'."
            )
        if self.num_envs % self.minibatches:
            raise UserError(
                f"minibatches ({self.minibatches}) must divide num_envs ({self.num_envs}): a "
                "minibatch is a group of whole environments."
            )


@dataclass(frozen=True, kw_only=True)
class A3CConfig(AlgorithmConfig):
    """Asynchronous advantage actor-critic; the defaults are the paper's (section 4.2.3).

    What the paper leaves open (rollout, gradient limit, value weight, epsilon) follows its
    public lineage of A3C for MuJoCo; see docs/decisions.md.

    Raises:
        UserError: a value out of its range.
    """

    name: Literal["a3c"] = "a3c"
    """Tells this config from the other algorithms' in a file."""

    workers: int = 17
    """Processes that collect and learn; one more evaluates."""

    envs_per_worker: int = 1
    """Environments a worker steps together; 1 is the paper, more is faster."""

    rollout_steps: int = 50
    """Steps of each environment between two updates; 50 is a whole episode."""

    learning_rate: float = 1e-4
    """RMSprop's step size."""

    rmsprop_decay: float = 0.99
    """How slowly RMSprop forgets old squared gradients."""

    rmsprop_epsilon: float = 1e-5
    """Added to the root of the mean squared gradient."""

    gamma: float = 0.99
    """Discount factor."""

    gae_lambda: float = 1.0
    """Lambda of the advantage estimate."""

    vf_coef: float = 0.5
    """Weight of the value loss."""

    ent_coef: float = 0.01
    """Weight of the entropy [1/nat]."""

    reward_scale: float = 1.0
    """Multiplies every reward before learning; reported returns are not scaled."""

    max_grad_norm: float = 40.0
    """Longer gradients are shortened to this norm."""

    matmul_precision: Literal["auto", "float32", "bfloat16"] = "float32"
    """Of the products in encoder and LSTM, as PPO's; ``auto`` makes many environments a worker
    about twice as fast where the processor computes bfloat16."""

    log_every_steps: int = 10_000
    """Environment steps, over all workers, between two rows of metrics."""

    def __post_init__(self) -> None:
        _at_least(self, 1, "workers", "envs_per_worker", "rollout_steps", "log_every_steps")
        _positive(self, "learning_rate", "rmsprop_epsilon", "reward_scale", "max_grad_norm")
        _share(self, "gamma", "gae_lambda", "rmsprop_decay")


def _given(config: object, *names: str) -> list[str]:
    return [name for name in names if getattr(config, name) is not None]


def _at_least(config: object, least: int, *names: str) -> None:
    for name in names:
        if getattr(config, name) < least:
            raise UserError(f"{name} must be at least {least}, got {getattr(config, name)}.")


def _positive(config: object, *names: str) -> None:
    for name in names:
        if not getattr(config, name) > 0:
            raise UserError(f"{name} must be larger than 0, got {getattr(config, name)}.")


def _share(config: object, *names: str) -> None:
    for name in names:
        if not 0 <= getattr(config, name) <= 1:
            raise UserError(f"{name} must lie between 0 and 1, got {getattr(config, name)}.")
