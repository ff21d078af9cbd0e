"""Activations and knowledge go in; both side by side come out, one class a place."""

import torch
from torch import Tensor

from knowarm.policy.config import PolicyConfig
from knowarm.policy.fusion.base import Fusion


class BeforeFC(Fusion):
    """Knowledge beside the convolution features."""

    def __init__(self, config: PolicyConfig) -> None:
        super().__init__(config)
        self.fc_growth = config.encoded_width

    def before_fc(self, x: Tensor, knowledge: Tensor) -> Tensor:
        """(N, F) -> (N, F + K)."""
        return torch.cat((x, knowledge), 1)


class BeforeLSTM(Fusion):
    """Knowledge beside the LSTM's inputs: the paper's place (section 4.2.2)."""

    def __init__(self, config: PolicyConfig) -> None:
        super().__init__(config)
        self.memory_growth = config.encoded_width

    def before_lstm(self, x: Tensor, knowledge: Tensor) -> Tensor:
        """(N, F) -> (N, F + K)."""
        return torch.cat((x, knowledge), 1)


class AfterLSTM(Fusion):
    """Knowledge beside the hidden state, for the actor and the critic."""

    def __init__(self, config: PolicyConfig) -> None:
        super().__init__(config)
        self.actor_growth = self.critic_growth = config.encoded_width

    def before_actor(self, x: Tensor, knowledge: Tensor) -> Tensor:
        """(N, H) -> (N, H + K)."""
        return torch.cat((x, knowledge), 1)

    def before_critic(self, x: Tensor, knowledge: Tensor) -> Tensor:
        """(N, H) -> (N, H + K)."""
        return torch.cat((x, knowledge), 1)


class CriticOnly(Fusion):
    """Knowledge for the critic alone: the policy never sees it and needs none when used."""

    def __init__(self, config: PolicyConfig) -> None:
        super().__init__(config)
        self.critic_growth = config.encoded_width

    def before_critic(self, x: Tensor, knowledge: Tensor) -> Tensor:
        """(N, H) -> (N, H + K)."""
        return torch.cat((x, knowledge), 1)
