"""A policy and a device go in; rollouts and gradients that one process computes there come out."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import torch
from torch import Tensor

from knowarm.learn.config import PPOConfig
from knowarm.learn.flat import FlatParameters
from knowarm.learn.losses import PPOLossTerms
from knowarm.learn.minibatch import Targets, differentiate, target_shapes
from knowarm.learn.player import play_rows
from knowarm.learn.precision import products
from knowarm.learn.recording import Recording
from knowarm.learn.rollout import Rollout, rollout_shapes
from knowarm.policy import Policy
from knowarm.policy.memory import State
from knowarm.policy.policy import MatmulPrecision


class Solo:
    """Plays and differentiates alone; see `Learner`.

    Args:
        policy: on the device.
        config: sizes of the rollout, weights of the loss.
        table: (F, K) float32 knowledge on the device.
        precision: of the products in encoder and memory.
        device: where everything is.
    """

    def __init__(
        self,
        policy: Policy,
        config: PPOConfig,
        table: Tensor,
        precision: MatmulPrecision,
        device: torch.device,
    ) -> None:
        self.policy = policy
        self._config = config
        self._table = table
        self._precision = precision
        self._device = device
        steps, count = config.rollout_steps, config.num_envs
        self.rollout = Rollout.zeros(rollout_shapes(steps, count, policy), device)
        self.targets = Targets(
            **{
                name: torch.zeros(shape, dtype=kind, device=device)
                for name, (shape, kind) in target_shapes(steps, count).items()
            }
        )
        self.gradient = FlatParameters(policy).gradient
        recorded = device.type == "cuda" and config.cuda_graphs
        self._compute: Callable[[Tensor], Tensor] = (
            Recording(self._terms) if recorded else self._terms
        )

    @contextmanager
    def at_work(self) -> Iterator[None]:
        """Have PyTorch keep to one thread, and a GPU to the precision."""
        before = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            with products(self._precision, self._device):
                yield
        finally:
            torch.set_num_threads(before)

    def play(self, rollout: Rollout, t: int, image: Tensor, state: State) -> tuple[Tensor, State]:
        """As `Player.play`."""
        return play_rows(self.policy, self._table, rollout, t, image, state, slice(None))

    def differentiate(self, columns: Tensor) -> PPOLossTerms:
        """As `Learner.differentiate`."""
        return PPOLossTerms.from_vector(self._compute(columns))

    def _terms(self, columns: Tensor) -> Tensor:
        self.gradient.zero_()
        return differentiate(
            self.policy, self._config, self._table, self.rollout, self.targets, columns
        ).vector()
