"""Configurations of the learning algorithms."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from knowarm.config import above_zero, at_least, check_values, fraction
from knowarm.errors import UserError

PRIVILEGED_OPTIONS: Mapping[str, tuple[Any, str]] = {
    "critic": ("image", "critic"),
    "auxiliary_coef": (0, "auxiliary loss"),
    "progress_coef": (0, "progress reward"),
    "imitation_coef": (0, "teacher"),
    "practice_until": (0, "practice starts"),
    "glimpse_until": (0, "glimpses"),
}
"""Options that need the simulator's state in training: value that does not, and what it is for."""


def privileged_uses(algorithm: Mapping[str, Any]) -> list[str]:
    """List what an algorithm, given its fields by name, uses the simulator's state for."""
    return [
        use
        for name, (without, use) in PRIVILEGED_OPTIONS.items()
        if algorithm.get(name, without) != without
    ]


class AlgorithmConfig:
    """Base class of the algorithms' configs, which have a literal field ``name``."""

    name: str


@dataclass(frozen=True, kw_only=True)
class ScheduleConfig(AlgorithmConfig):
    """What changes during a training: learning rate and success thresholds."""

    learning_rate: float
    """Learning rate at the start of training."""
    learning_rate_schedule: Literal["constant", "linear", "cosine"] = "linear"
    """How the learning rate decreases over the whole training."""
    learning_rate_final: float = 0.1
    """Learning rate at the end of training, as a fraction of the initial one."""
    threshold_factor: float = 1.0
    """Factor of both success thresholds at the start of training; 1: the task's own."""
    threshold_decrease: float = 0.02
    """Decrease of the factor per update, down to 1."""
    threshold_success: float = 0.5
    """Success of an update's episodes above which the factor decreases."""

    def __post_init__(self) -> None:
        check_values(self)
        above_zero(self, "learning_rate")
        fraction(self, "threshold_success", "learning_rate_final")
        at_least(self, 0, "threshold_decrease")
        at_least(self, 1, "threshold_factor")

    def learning_rate_at(self, progress: float) -> float:
        """Return the learning rate after a fraction ``progress`` of the training, cut to 0..1.

        It decreases from ``learning_rate`` to ``learning_rate_final`` times that along a line or
        half a cosine, or stays constant.
        """
        start, final = self.learning_rate, self.learning_rate_final
        progress = min(max(progress, 0.0), 1.0)
        if self.learning_rate_schedule == "constant":
            return start
        linear = self.learning_rate_schedule == "linear"
        remaining = 1 - progress if linear else 0.5 * (1 + math.cos(math.pi * progress))
        return start * (final + (1 - final) * remaining)


@dataclass(frozen=True, kw_only=True)
class PPOConfig(ScheduleConfig):
    """Recurrent PPO; the defaults learned fastest in our tests (docs/lab-notes.md).

    Raises:
        UserError: a value out of range, or minibatches that do not divide the environments.
    """

    name: Literal["ppo"] = "ppo"
    """Identifies the algorithm in a config file."""
    num_envs: int = 128
    """Number of environments."""
    rollout_steps: int = 25
    """Steps per environment between two updates."""
    epochs: int = 2
    """Passes over each rollout per update."""
    minibatches: int = 4
    """Groups of environments that a pass is divided into; one gradient step per group."""
    optimizer: Literal["adam", "muon", "muon-float32"] = "adam"
    """Adam, or Muon for some matrices and Adam for all else, at the same learning rate. "muon"
    updates the fully connected layer and the LSTM by five iterations, in bfloat16 where the
    processor computes it; "muon-float32" the fully connected layer and the convolution kernels by
    three in float32."""
    learning_rate: float = 1e-3

    adam_eps: float = 1e-5
    """Epsilon of Adam."""
    gamma: float = 0.95
    """Discount factor. The paper's A3C uses .99; with .95 three times as many episodes succeeded
    after 600,000 steps, since a reach takes 5 to 16 steps (docs/lab-notes.md)."""
    gae_lambda: float = 0.95
    """Lambda of the generalized advantage estimate (GAE)."""
    clip_range: float = 0.2
    """Clipping range of the probability ratio: 1 - clip_range to 1 + clip_range."""
    vf_coef: float = 0.5
    """Coefficient of the value loss."""
    ent_coef: float = 0.003
    """Coefficient of the entropy bonus [1/nat]."""
    reward_scale: float = 0.05
    """Factor of every reward in learning; reported returns are not scaled."""
    normalize_advantages: bool = True
    """Normalize the advantages of a rollout to mean 0 and standard deviation 1."""
    max_grad_norm: float = 0.5
    """Gradients are clipped to this norm."""
    critic: Literal["image", "state"] = "image"
    """What values an observation: the policy's own head, or a network on the simulator's state
    (asymmetric actor-critic, Pinto et al. 2017). The head is then trained, but not used."""
    auxiliary_coef: float = 0.0
    """Coefficient of the auxiliary loss: predict joint angles, gripper and grasp frame from the
    features of the image; 0: none."""
    progress_coef: float = 0.0
    """Factor of a reward for every step's decrease of distance (100 per metre) and angle (20 per
    90 degrees), added to the task's reward; 0: none."""
    imitation_coef: float = 0.0
    """Coefficient of the imitation loss: the cross-entropy of the policy to the actions of a
    teacher that solves the inverse kinematics, in the states that the policy visits (DAgger, Ross
    et al. 2011); 0: none."""
    imitation_stay: float = 0.0
    """Share of each label of the imitation loss that is given to action 0, which moves nothing,
    instead of the teacher's: a joint then stays where the image does not show its direction, as
    the most probable action moves only if its direction is much more probable than the other."""
    imitation_way: float | None = None
    """Weigh the imitation loss of each joint by its way to the solution, up to this one [largest
    steps], so that a turn far beyond the goal counts more than one step too many; None: all
    alike."""
    reinforcement_coef: float = 1.0
    """Coefficient of PPO's own loss (policy, value, entropy); 0 leaves imitation and auxiliary loss
    alone, and the policy then acts by its most probable actions."""
    practice_until: float = 0.0
    """Fraction of the training during which the share of episodes that start on the teacher's way
    to the goal, with noise, falls from all to none; 0: all episodes start as the task draws
    them."""
    glimpse_until: float = 0.0
    """Fraction of the training in which the policy does not act: every environment starts a new
    episode for each image, and learns what the teacher would do. Such images differ more than
    those of an episode and cost half as much; 0: the policy acts from the start."""
    average_updates: int | None = None
    """Number of updates over which the parameters are averaged (exponentially) for interim
    evaluations and the best policy, which then act with the averages; None: not averaged."""
    target_kl: float | None = None
    """End the passes over a rollout when the approximate KL divergence exceeds it [nat]; None:
    no limit."""
    device: Literal["cpu", "cuda"] = "cpu"
    """Device of policy, rollouts and gradients; simulation and rendering use the CPU."""
    matmul_precision: Literal["auto", "float32", "bfloat16"] = "auto"
    """Precision of the matrix products in encoder and LSTM during training: "auto" is bfloat16
    where the device computes it in hardware, else float32. Parameters, cell state, heads and
    losses are always float32."""
    processes: int | None = None
    """Processes that share the network's computations on the CPU, one thread each; None: one per
    core, at most one per eight environments of a minibatch. Another number of processes rounds
    sums differently."""

    def __post_init__(self) -> None:
        super().__post_init__()
        counts = ("num_envs", "rollout_steps", "epochs", "minibatches", "processes")
        at_least(self, 1, *counts, "average_updates")
        above_zero(self, "adam_eps", "clip_range", "reward_scale", "max_grad_norm", "target_kl")
        at_least(self, 1, "imitation_way")
        fraction(self, "gamma", "gae_lambda", "practice_until", "glimpse_until", "imitation_stay")
        learns = ("auxiliary_coef", "imitation_coef", "reinforcement_coef")
        at_least(self, 0, *learns, "progress_coef", "vf_coef", "ent_coef")
        if not any(getattr(self, name) for name in learns):
            raise UserError(f"{', '.join(learns)} are all 0: nothing is learned. Set one above 0.")
        if self.glimpse_until and (self.reinforcement_coef or self.target_kl):
            raise UserError(
                f"glimpse_until is {self.glimpse_until}, reinforcement_coef "
                f"{self.reinforcement_coef} and target_kl {self.target_kl}: glimpses have no "
                "actions to reinforce. Set glimpse_until to 0, or leave the others 0 and None."
            )
        if self.normalize_advantages and self.num_envs * self.rollout_steps == 1:
            raise UserError(
                "One step of one environment has no deviation to normalize advantages by: raise "
                "num_envs or rollout_steps, or set normalize_advantages to False."
            )
        if self.device == "cuda" and self.processes is not None:
            raise UserError(
                f"processes ({self.processes}) applies to device 'cpu' only; leave it None "
                "with device 'cuda'."
            )
        if self.num_envs % self.minibatches:
            raise UserError(
                f"minibatches ({self.minibatches}) must divide num_envs ({self.num_envs}): a "
                "minibatch is a group of whole environments."
            )

    def practice_share_at(self, progress: float) -> float:
        """Return the share of practice starts after a fraction ``progress`` of the training."""
        return max(0.0, 1 - progress / self.practice_until) if self.practice_until else 0.0


@dataclass(frozen=True, kw_only=True)
class A3CConfig(ScheduleConfig):
    """Asynchronous advantage actor-critic (A3C); defaults as in the paper (section 4.2).

    What the paper does not give (rollouts, time limit, max_grad_norm, rmsprop_eps) follows the
    public A3C for MuJoCo that its lineage leads to (Feryal/a3c-mujoco); see the table in
    docs/decisions.md.

    Raises:
        UserError: a value out of range, or rollouts that end with the episode of several
            environments.
    """

    name: Literal["a3c"] = "a3c"
    """Identifies the algorithm in a config file."""
    workers: int = 17
    """Worker processes that collect and learn; one more process evaluates."""
    envs_per_worker: int = 1
    """Environments per worker; 1 in the paper, more are faster."""
    rollout_steps: int = 50
    """Steps per environment between two updates, at most; 50 is a whole episode."""
    rollout_ends_with_episode: bool = True
    """End a rollout where the episode ends, as the lineage does; needs one environment per worker.
    Otherwise all rollouts have ``rollout_steps`` steps and may span the end of an episode."""
    bootstrap_at_time_limit: bool = False
    """Continue the return of an episode that the time limit ends with the value of its last image.
    The lineage lets it end with zero, as after a success."""
    learning_rate: float = 1e-4

    learning_rate_schedule: Literal["constant", "linear", "cosine"] = "constant"

    rmsprop_alpha: float = 0.99
    """Decay of RMSprop's running mean of squared gradients."""
    rmsprop_eps: float = 1e-8
    """Epsilon of RMSprop, added to the root of the mean squared gradient."""
    gamma: float = 0.99
    """Discount factor."""
    gae_lambda: float = 1.0
    """Lambda of the generalized advantage estimate (GAE)."""
    vf_coef: float = 1.0
    """Coefficient of the value loss, which is half the mean squared error: 1 gives the paper's
    1/2 (R - V)^2 (section 4.2.1)."""
    ent_coef: float = 0.01
    """Coefficient of the entropy bonus [1/nat]."""
    reward_scale: float = 1.0
    """Factor of every reward in learning; reported returns are not scaled."""
    max_grad_norm: float = 40.0
    """Gradients are clipped to this norm."""
    matmul_precision: Literal["auto", "float32", "bfloat16"] = "float32"
    """Precision of the matrix products in encoder and LSTM; "auto" is bfloat16 where the CPU
    computes it in hardware, about twice as fast with many environments per worker."""
    log_every_steps: int = 10_000
    """Environment steps, summed over all workers, between two rows of metrics."""

    def __post_init__(self) -> None:
        super().__post_init__()
        at_least(self, 1, "workers", "envs_per_worker", "rollout_steps", "log_every_steps")
        at_least(self, 0, "vf_coef", "ent_coef")
        above_zero(self, "rmsprop_eps", "reward_scale", "max_grad_norm")
        fraction(self, "gamma", "gae_lambda", "rmsprop_alpha")
        if self.rollout_ends_with_episode and self.envs_per_worker > 1:
            raise UserError(
                f"envs_per_worker is {self.envs_per_worker}, and rollout_ends_with_episode needs "
                "one environment per worker: set rollout_ends_with_episode to False, or "
                "envs_per_worker to 1."
            )
