"""A policy, a device and a number of processes go in; what does PPO's arithmetic comes out."""

from contextlib import AbstractContextManager
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from knowarm.cores import available_cores
from knowarm.learn.config import PPOConfig
from knowarm.learn.losses import PPOLossTerms
from knowarm.learn.minibatch import Targets
from knowarm.learn.rollout import Rollout
from knowarm.learn.solo import Solo
from knowarm.learn.team import Team
from knowarm.policy import Policy
from knowarm.policy.memory import State
from knowarm.policy.policy import MatmulPrecision

SMALLEST_PART = 8
"""Environments of a minibatch that a process is worth having for."""


class Learner(Protocol):
    """Plays rollouts and differentiates minibatches of them.

    Attributes:
        policy: as given; its parameters and gradients are parts of two long vectors.
        rollout: what `play` writes and `differentiate` reads.
        targets: likewise.
        gradient: (P,) float32, the gradient after `differentiate`.
    """

    policy: Policy
    rollout: Rollout
    targets: Targets
    gradient: Tensor

    def at_work(self) -> AbstractContextManager[None]:
        """Hold what is needed while training."""
        ...

    def play(self, rollout: Rollout, t: int, image: Tensor, state: State) -> tuple[Tensor, State]:
        """As `Player.play`; the state that is returned may be overwritten by the next call."""
        ...

    def differentiate(self, columns: Tensor) -> PPOLossTerms:
        """Compute the loss terms of the environments ``columns`` (b,) and leave their gradient."""
        ...


def make_learner(
    policy: Policy,
    config: PPOConfig,
    table: np.ndarray,
    precision: MatmulPrecision,
    device: torch.device,
) -> Learner:
    """Return a team where several processes are wanted and worth it, else one alone.

    Args:
        policy: the policy; it is moved to the device.
        config: sizes, and how many processes.
        table: (F, K) float32 knowledge.
        precision: of the products in encoder and memory.
        device: where to learn.
    """
    policy.to(device)
    processes = count_processes(config) if device.type == "cpu" else 1
    if processes > 1:
        return Team(policy, config, table, precision, processes)
    placed = torch.tensor(table, dtype=torch.float32, device=device)
    return Solo(policy, config, placed, precision, device)


def count_processes(config: PPOConfig) -> int:
    """Number of processes that a config asks for and its minibatches are worth."""
    worth = config.num_envs // config.minibatches // SMALLEST_PART
    return max(1, min(config.processes or available_cores(), worth))
