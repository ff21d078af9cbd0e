"""Learner: inference and minibatch gradients of PPO in the calling process."""

from contextlib import AbstractContextManager

import torch
from torch import Tensor

from knowarm.cores import torch_threads
from knowarm.learn.algorithms import PPOConfig
from knowarm.learn.losses import PPOLossTerms
from knowarm.learn.parallel.shared_tensors import FlatParameters, zeros
from knowarm.learn.rollout import (
    Rollout,
    Targets,
    TrainingNetwork,
    add_gradient,
    buffer_specs,
    buffers,
    infer_step,
)
from knowarm.policy import State


class Learner:
    """Computes inference and minibatch gradients in one process.

    The collector and `infer` write ``rollout``, the trainer ``targets``; `compute_gradient` reads
    both and writes ``gradient``, (P,) float32, of all parameters of ``network``.

    Attributes:
        processes: number of processes that share the work.
    """

    processes = 1
    rollout: Rollout
    targets: Targets
    gradient: Tensor

    def __init__(self, network: TrainingNetwork, config: PPOConfig, device: torch.device) -> None:
        self.network = network
        self.policy = network.policy
        self._config = config
        self._allocate(device)

    def _allocate(self, device: torch.device) -> None:
        tensors = zeros(buffer_specs(self.network, self._config), device)
        self.rollout, self.targets = buffers(tensors)
        self.gradient = FlatParameters(self.network).gradient

    def running(self) -> AbstractContextManager[None]:
        """Use one PyTorch thread until the context ends."""
        return torch_threads(1)

    def infer(self, rollout: Rollout, t: int, image: Tensor, state: State) -> tuple[Tensor, State]:
        """Run the policy for step t, as `infer_step`; the next call may overwrite the state."""
        return infer_step(self.policy, rollout, t, image, state)

    def compute_gradient(self, env_ids: Tensor) -> PPOLossTerms:
        """Compute loss terms and gradient over the environments ``env_ids`` (b,) int64."""
        self.gradient.zero_()
        return add_gradient(self.network, self._config, self.rollout, self.targets, env_ids)
