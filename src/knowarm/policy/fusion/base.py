"""Activations go in and come out unchanged: the fusion that every other one overrides."""

import torch
from torch import Tensor, nn

from knowarm.policy.config import PolicyConfig
from knowarm.policy.encoder import ImageEncoder


class Fusion(nn.Module):
    """Where knowledge may enter the network, and by how much each place grows.

    A fusion overrides the method of the place it uses and sets the growth of the layer after
    it. All methods take activations (N, width) and encoded knowledge (N, K).
    """

    fc_growth = 0
    """Inputs added to the fully connected layer."""
    memory_growth = 0
    """Inputs added to the LSTM."""
    actor_growth = 0
    """Inputs added to the actor heads."""
    critic_growth = 0
    """Inputs added to the critic."""

    def __init__(self, config: PolicyConfig) -> None:
        super().__init__()

    def reset_parameters(self, generator: torch.Generator) -> None:
        """Draw the fusion's own parameters, if it has any."""

    def before_fc(self, x: Tensor, knowledge: Tensor) -> Tensor:
        """Convolution features to inputs of the fully connected layer."""
        return x

    def before_lstm(self, x: Tensor, knowledge: Tensor) -> Tensor:
        """Features to inputs of the LSTM."""
        return x

    def before_actor(self, x: Tensor, knowledge: Tensor) -> Tensor:
        """Hidden states to inputs of the actor heads."""
        return x

    def before_critic(self, x: Tensor, knowledge: Tensor) -> Tensor:
        """Hidden states to inputs of the critic."""
        return x


CHANNELS = ImageEncoder.channels
