"""Learner: inference and minibatch gradients of PPO, in one process or several."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol

import torch
from torch import Tensor

from knowarm.cores import available_cores
from knowarm.learn.collector import infer_step
from knowarm.learn.config import PPOConfig
from knowarm.learn.data_parallel import DataParallelLearner
from knowarm.learn.device import CudaGraph, tf32_products
from knowarm.learn.flat_parameters import FlatParameters
from knowarm.learn.losses import PPOLossTerms
from knowarm.learn.minibatch import Targets, add_gradient, target_specs
from knowarm.learn.rollout import Rollout, rollout_specs
from knowarm.policy import MatmulPrecision, Policy, State

MIN_ENVS_PER_PROCESS = 8
"""Environments of a minibatch below which another process does not pay."""


class Learner(Protocol):
    """Computes inference and minibatch gradients.

    Attributes:
        policy: as given; its parameters and gradients become views of two vectors.
        rollout: written by `infer` and the collector, read by `compute_gradient`.
        targets: read by `compute_gradient`.
        gradient: (P,) float32, written by `compute_gradient`.
    """

    policy: Policy
    rollout: Rollout
    targets: Targets
    gradient: Tensor

    def running(self) -> AbstractContextManager[None]:
        """Return the context in which the learner works: processes, thread count, precision."""
        ...

    def infer(self, rollout: Rollout, t: int, image: Tensor, state: State) -> tuple[Tensor, State]:
        """Run the policy for step t, as `infer_step`; the next call may overwrite the state."""
        ...

    def compute_gradient(self, env_ids: Tensor) -> PPOLossTerms:
        """Compute loss terms and gradient over the environments ``env_ids`` (b,) int64."""
        ...


class SingleProcessLearner:
    """Learner that works in the calling process, on the CPU or a GPU; see `Learner`.

    Args:
        policy: on the device.
        config: rollout size and loss weights.
        precision: of the matrix products.
        device: of policy, rollout and targets.
    """

    def __init__(
        self, policy: Policy, config: PPOConfig, precision: MatmulPrecision, device: torch.device
    ) -> None:
        self.policy = policy
        self._config = config
        self._precision = precision
        self._device = device
        steps, count = config.rollout_steps, config.num_envs
        self.rollout = Rollout.zeros(rollout_specs(steps, count, policy), device)
        self.targets = Targets(
            **{
                name: torch.zeros(shape, dtype=dtype, device=device)
                for name, (shape, dtype) in target_specs(steps, count).items()
            }
        )
        self.gradient = FlatParameters(policy).gradient
        self._compute: Callable[[Tensor], Tensor] = self._loss_vector
        if device.type == "cuda" and config.cuda_graphs:
            self._compute = CudaGraph(self._loss_vector)

    @contextmanager
    def running(self) -> Iterator[None]:
        """Use one PyTorch thread, and on a GPU the precision, until the context ends."""
        before = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            with tf32_products(self._precision, self._device):
                yield
        finally:
            torch.set_num_threads(before)

    def infer(self, rollout: Rollout, t: int, image: Tensor, state: State) -> tuple[Tensor, State]:
        """As `Learner.infer`."""
        return infer_step(self.policy, rollout, t, image, state)

    def compute_gradient(self, env_ids: Tensor) -> PPOLossTerms:
        """As `Learner.compute_gradient`."""
        return PPOLossTerms.from_vector(self._compute(env_ids))

    def _loss_vector(self, env_ids: Tensor) -> Tensor:
        self.gradient.zero_()
        terms = add_gradient(self.policy, self._config, self.rollout, self.targets, env_ids)
        return terms.vector()


def make_learner(
    policy: Policy, config: PPOConfig, precision: MatmulPrecision, device: torch.device
) -> Learner:
    """Return a learner with as many processes as the config asks for and pay.

    Args:
        policy: moved to the device.
        config: sizes and number of processes.
        precision: of the matrix products in encoder and LSTM.
        device: where to learn.
    """
    policy.to(device)
    processes = count_processes(config) if device.type == "cpu" else 1
    if processes > 1:
        return DataParallelLearner(policy, config, precision, processes)
    return SingleProcessLearner(policy, config, precision, device)


def count_processes(config: PPOConfig) -> int:
    """Return the number of processes: as configured, limited by the size of a minibatch."""
    most = config.num_envs // config.minibatches // MIN_ENVS_PER_PROCESS
    return max(1, min(config.processes or available_cores(), most))
