"""Learner: inference and minibatch gradients of PPO in the calling process."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import torch
from torch import Tensor

from knowarm.learn.collector import infer_step
from knowarm.learn.config import PPOConfig
from knowarm.learn.device import CudaGraph, tf32_products
from knowarm.learn.flat_parameters import FlatParameters
from knowarm.learn.losses import PPOLossTerms
from knowarm.learn.minibatch import Targets, TrainingNetwork, add_gradient, target_specs
from knowarm.learn.rollout import Rollout, rollout_specs
from knowarm.learn.shared_tensors import zeros
from knowarm.policy import MatmulPrecision, State
from knowarm.threads import torch_threads


class Learner:
    """Computes inference and minibatch gradients on the CPU or a GPU.

    Args:
        network: on the device; its parameters and gradients become views of two vectors.
        config: rollout size and loss weights.
        precision: of the matrix products in encoder and LSTM.
        device: of policy, rollout and targets.

    Attributes:
        network: as given.
        rollout: written by `infer` and the collector, read by `compute_gradient`.
        targets: read by `compute_gradient`.
        gradient: (P,) float32, written by `compute_gradient`.
        processes: number of processes that share the work.
    """

    processes = 1
    rollout: Rollout
    targets: Targets
    gradient: Tensor

    def __init__(
        self,
        network: TrainingNetwork,
        config: PPOConfig,
        precision: MatmulPrecision,
        device: torch.device,
    ) -> None:
        self.network = network
        self.policy = network.policy
        self._config = config
        self._precision = precision
        self._device = device
        self._allocate()
        self._compute: Callable[[Tensor], Tensor] = self._loss_vector
        self._step: CudaGraph | None = None
        if device.type == "cuda" and config.cuda_graphs:
            self._compute = CudaGraph(self._loss_vector)
            self._step = CudaGraph(self._infer)

    def _allocate(self) -> None:
        steps, count = self._config.rollout_steps, self._config.num_envs
        self.rollout = Rollout(**zeros(rollout_specs(steps, count, self.policy), self._device))
        specs = target_specs(steps, count, self.network.auxiliary_targets)
        self.targets = Targets(**zeros(specs, self._device))
        self.gradient = FlatParameters(self.network).gradient

    @contextmanager
    def running(self) -> Iterator[None]:
        """Use one PyTorch thread, and on a GPU the precision, until the context ends."""
        with torch_threads(1), tf32_products(self._precision, self._device):
            yield

    def infer(self, rollout: Rollout, t: int, image: Tensor, state: State) -> tuple[Tensor, State]:
        """Run the policy for step t, as `infer_step`; the next call may overwrite the state."""
        if self._step is None:
            return infer_step(self.policy, rollout, t, image, state)
        facet, start = rollout.facet[t], rollout.episode_start[t]
        patches, logits, values, h, c = self._step(image, facet, start, *state)
        rollout.patches[t] = patches
        rollout.value[t] = values
        return logits.clone(), (h, c)

    def compute_gradient(self, env_ids: Tensor) -> PPOLossTerms:
        """Compute loss terms and gradient over the environments ``env_ids`` (b,) int64."""
        return PPOLossTerms.from_vector(self._compute(env_ids))

    @torch.no_grad()
    def _infer(
        self, image: Tensor, facet: Tensor, start: Tensor, h: Tensor, c: Tensor
    ) -> tuple[Tensor, ...]:
        """Run the policy for a step: patches, logits, values and the next state."""
        patches = self.policy.patches(image)
        logits, values, state = self.policy.step(patches, facet, (h, c), start)
        return patches, logits, values, *state

    def _loss_vector(self, env_ids: Tensor) -> Tensor:
        self.gradient.zero_()
        terms = add_gradient(self.network, self._config, self.rollout, self.targets, env_ids)
        return terms.vector()
