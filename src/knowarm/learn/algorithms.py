"""Configurations of the learning algorithms."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from knowarm.config import check_values
from knowarm.errors import UserError
from knowarm.ranges import MOST_FLOAT, within

PRIVILEGED_OPTIONS = {
    "critic": "critic",
    "auxiliary_coef": "auxiliary loss",
    "progress_coef": "progress reward",
    "way_limit": "teacher",
    "practice_until": "practice starts",
    "glimpse_until": "glimpses",
}
"""Options that need the simulator's state in training unless they are 0, and what it is for."""


def privileged_uses(algorithm: Mapping[str, Any]) -> list[str]:
    """List what an algorithm, as a mapping of its fields, uses the simulator's state for."""
    fields = {**algorithm, **algorithm.get("privileged", {})}
    return [use for name, use in PRIVILEGED_OPTIONS.items() if fields.get(name)]


SHORTEST_WAY = 0.5
"""Way at least assumed in the weights of imitation [largest steps]; within it a joint stays."""


Schedule = Literal["constant", "linear", "cosine"]
Optimizer = Literal["adam", "muon", "muon-float32"]
Precision = Literal["auto", "float32", "bfloat16"]


class AlgorithmConfig:
    """Base class of the algorithms' configs, which have a literal field ``name``."""

    name: str


@dataclass(frozen=True, kw_only=True)
class SeenConfig(AlgorithmConfig):
    """No policy: inverse kinematics move the arm to what the grounding network sees."""

    name: Literal["seen"] = "seen"
    """Identifies the algorithm in a config file."""


@dataclass(frozen=True, kw_only=True)
class ScheduleConfig(AlgorithmConfig):
    """The learning rate over a training."""

    learning_rate: float
    """Learning rate at the start of training."""
    learning_rate_schedule: Schedule = "linear"
    """How the learning rate decreases over the whole training."""
    learning_rate_final: float = 0.1
    """Learning rate at the end of training, as a fraction of the initial one."""

    def __post_init__(self) -> None:
        check_values(self)

    def learning_rate_at(self, progress: float) -> float:
        """Return the learning rate after a fraction ``progress`` of the training, cut to 0..1."""
        if self.learning_rate_schedule == "constant":
            return self.learning_rate
        progress = min(max(progress, 0.0), 1.0)
        if self.learning_rate_schedule == "linear":
            remaining = 1 - progress
        else:
            remaining = 0.5 * (1 + math.cos(math.pi * progress))
        final = self.learning_rate_final
        return self.learning_rate * (final + (1 - final) * remaining)


@dataclass(frozen=True, kw_only=True)
class ThresholdConfig:
    """Success thresholds that start large and shrink to the task's own while training succeeds.

    From half to three quarters of the training they shrink in any case, so that every agent ends
    with the task's own.
    """

    threshold_factor: float = 1.0
    """Factor of both success thresholds at the start of training; 1: the task's own."""
    threshold_decrease: float = 0.02
    """Decrease of the factor per update in which most episodes succeed, down to 1."""

    def __post_init__(self) -> None:
        check_values(self)


@dataclass(frozen=True, kw_only=True)
class PrivilegedConfig(ThresholdConfig):
    """What PPO's training takes from the simulator; the policy itself plays from images alone."""

    critic: bool = False
    """Value observations by a network on the simulator's state (asymmetric actor-critic, Pinto et
    al. 2017) instead of the policy's own head, which is then trained, but not used."""
    auxiliary_coef: float = 0.0
    """Coefficient of the auxiliary loss: predict joint angles, gripper and grasp frame from the
    features of the image; 0: none."""
    progress_coef: float = 0.0
    """Factor of a reward for every step's decrease of distance (100 per metre) and angle (20 per
    90 degrees), added to the task's reward; 0: none."""


@dataclass(frozen=True, kw_only=True)
class MinibatchConfig(ScheduleConfig):
    """What algorithms share that learn from minibatches of whole environments."""

    num_envs: int = 128
    """Number of environments."""
    rollout_steps: int = 25
    """Steps per environment between two updates."""
    epochs: int = 2
    """Passes over each rollout per update."""
    minibatches: int = 4
    """Groups of environments that a pass is divided into; one gradient step per group."""
    optimizer: Optimizer = "adam"
    """Adam, or Muon for some matrices and Adam for all else, at the same learning rate. "muon"
    updates the fully connected layer and the LSTM by five iterations, in bfloat16 where the
    processor computes it; "muon-float32" the fully connected layer and the convolution kernels by
    three in float32."""
    learning_rate: float = 1e-3

    max_grad_norm: float = 0.5
    """Gradients are clipped to this norm."""
    device: Literal["cpu", "cuda"] = "cpu"
    """Device of policy, rollouts and gradients; simulation and rendering use the CPU."""
    matmul_precision: Precision = "auto"
    """Precision of the matrix products in encoder and LSTM during training: "auto" is bfloat16
    where the device computes it in hardware, else float32. Parameters, cell state, heads and
    losses are always float32."""
    processes: int | None = None
    """Processes that share the network's computations on the CPU, one thread each; None: one per
    core, at most one per eight environments of a minibatch. Another number of processes rounds
    sums differently."""

    def __post_init__(self) -> None:
        super().__post_init__()
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


@dataclass(frozen=True, kw_only=True)
class PPOConfig(MinibatchConfig):
    """Recurrent PPO; the defaults learned fastest in our tests (docs/lab-notes.md).

    Raises:
        UserError: a value out of range, or minibatches that do not divide the environments.
    """

    name: Literal["ppo"] = "ppo"
    """Identifies the algorithm in a config file."""
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
    privileged: PrivilegedConfig = field(default_factory=PrivilegedConfig)
    """What training takes from the simulator besides images and rewards; nothing by default."""


@dataclass(frozen=True, kw_only=True)
class DistilConfig(MinibatchConfig):
    """Imitation of a teacher in the states that the policy visits (DAgger, Ross et al. 2011).

    The teacher solves the inverse kinematics on the simulator's state; the policy sees images, and
    acts by its most probable actions.

    Raises:
        UserError: a value out of range, or minibatches that do not divide the environments.
    """

    name: Literal["distil"] = "distil"
    """Identifies the algorithm in a config file."""
    num_envs: int = 512
    rollout_steps: int = 1
    epochs: int = 1
    minibatches: int = 16
    optimizer: Optimizer = "muon-float32"
    learning_rate: float = 3e-3
    learning_rate_final: float = 0.02

    auxiliary_coef: float = 4.0
    """Coefficient of the auxiliary loss: predict joint angles, gripper, grasp frame and the way to
    the teacher's solution from the features of the image; 0: none."""
    stay_share: float = 0.38
    """Share of each label that is given to action 0, which moves nothing, instead of the
    teacher's: a joint then stays where the image does not show its direction, as the most probable
    action moves only if its direction is much more probable than the other."""
    way_limit: float = 5.0
    """Weigh the loss of each joint by its way to the solution, from half a largest step up to this
    one [largest steps], so that a turn far beyond the goal counts more than one step too many."""
    practice_until: float = 1.0
    """Fraction of the training during which the share of episodes that start on the teacher's path
    to the goal, with noise, falls from all to none; 0: all episodes start as the task draws
    them."""
    glimpse_until: float = 0.2
    """Fraction of the training in which the policy does not act: every environment starts a new
    episode for each image, and learns what the teacher would do. Such images differ more than
    those of an episode and cost half as much; 0: the policy acts from the start."""

    def __post_init__(self) -> None:
        super().__post_init__()
        within(self, SHORTEST_WAY, MOST_FLOAT, "way_limit")

    def practice_share_at(self, progress: float) -> float:
        """Return the share of practice starts after a fraction ``progress`` of the training."""
        if self.practice_until == 0:
            return 0.0
        return max(0.0, 1 - progress / self.practice_until)


@dataclass(frozen=True, kw_only=True)
class A3CConfig(ThresholdConfig, ScheduleConfig):
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
    schedule: Literal["fixed", "asynchronous"] | None = None
    """"fixed": all workers in one process, whose updates follow each other in a fixed order, so
    that a training repeats to the byte. "asynchronous": a process per worker, whose updates follow
    each other as they come. None: fixed where workers have one environment each."""
    workers: int = 17
    """Workers that collect and learn."""
    envs_per_worker: int = 1
    """Environments per worker; 1 in the paper and on the fixed schedule, more are faster."""
    rollout_steps: int = 50
    """Steps per environment between two updates, at most; 50 is a whole episode."""
    rollout_ends_with_episode: bool = True
    """End a rollout where the episode ends, as the lineage does; needs one environment per worker.
    Otherwise all rollouts have ``rollout_steps`` steps and may span the end of an episode."""
    bootstrap_at_time_limit: bool = False
    """Continue the return of an episode that the time limit ends with the value of its last image.
    The lineage lets it end with zero, as after a success."""
    learning_rate: float = 1e-4

    learning_rate_schedule: Schedule = "constant"

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
    matmul_precision: Precision = "float32"
    """Precision of the matrix products in encoder and LSTM; "auto" is bfloat16 where the CPU
    computes it in hardware, about twice as fast with many environments per worker."""
    log_every_steps: int = 10_000
    """Environment steps, summed over all workers, between two rows of metrics."""

    def __post_init__(self) -> None:
        check_values(self)
        if self.schedule == "fixed" and self.envs_per_worker > 1:
            raise UserError(
                f"envs_per_worker is {self.envs_per_worker}, and workers on the fixed schedule "
                "have one environment each: set schedule to 'asynchronous', or envs_per_worker "
                "to 1."
            )
        if self.rollout_ends_with_episode and self.envs_per_worker > 1:
            raise UserError(
                f"envs_per_worker is {self.envs_per_worker}, and rollout_ends_with_episode needs "
                "one environment per worker: set rollout_ends_with_episode to False, or "
                "envs_per_worker to 1."
            )

    @property
    def is_fixed(self) -> bool:
        """Whether the schedule is fixed."""
        return self.schedule == "fixed" or (
            self.schedule is None and self.envs_per_worker == 1
        )
