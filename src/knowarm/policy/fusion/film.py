"""Convolution features and knowledge go in; scaled and shifted channels come out."""

import torch
from torch import Tensor, nn

from knowarm.policy.config import PolicyConfig
from knowarm.policy.fusion.base import CHANNELS, Fusion
from knowarm.policy.initialization import orthogonal


class FiLM(Fusion):
    """Feature-wise linear modulation of the second convolution's channels.

    ``x[p, c] -> (1 + gamma_c(k)) x[p, c] + beta_c(k)`` at every position p (Perez et al. 2018,
    with the 1 that keeps the untrained network unmodulated).
    """

    def __init__(self, config: PolicyConfig) -> None:
        super().__init__(config)
        self.modulation = nn.Linear(config.encoded_width, 2 * CHANNELS)

    def reset_parameters(self, generator: torch.Generator) -> None:
        """Draw small weights: modulation starts near none."""
        orthogonal(self.modulation, 0.1, generator)

    def before_fc(self, x: Tensor, knowledge: Tensor) -> Tensor:
        """(N, positions * channels) -> the same shape."""
        gamma, beta = self.modulation(knowledge)[:, None].chunk(2, 2)
        maps = x.view(x.shape[0], -1, CHANNELS)
        return torch.addcmul(beta, 1 + gamma, maps).flatten(1)
