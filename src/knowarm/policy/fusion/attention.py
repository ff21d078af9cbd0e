"""Features and knowledge slots go in; features and the slot mixture they asked for come out."""

import math

import torch
from torch import Tensor, nn

from knowarm.policy.config import PolicyConfig
from knowarm.policy.fusion.base import Fusion
from knowarm.policy.initialization import orthogonal


class Attention(Fusion):
    """Cross-attention: the image's features ask, the slots of the knowledge answer.

    ``q = W_q x``, ``k_s = W_k slot_s``, ``v_s = W_v slot_s``; the answer
    ``sum_s softmax_s(q . k_s / sqrt(d)) v_s`` stands beside the LSTM's inputs.
    """

    def __init__(self, config: PolicyConfig) -> None:
        super().__init__(config)
        self.slots = config.knowledge_slots
        width = config.encoded_width // self.slots
        self.memory_growth = width
        self.query = nn.Linear(config.features, width)
        self.key = nn.Linear(width, width)
        self.value = nn.Linear(width, width)

    def reset_parameters(self, generator: torch.Generator) -> None:
        """Draw the three maps orthogonal."""
        for layer in (self.query, self.key, self.value):
            orthogonal(layer, 1.0, generator)

    def before_lstm(self, x: Tensor, knowledge: Tensor) -> Tensor:
        """(N, F) -> (N, F + K / slots)."""
        slots = knowledge.view(knowledge.shape[0], self.slots, -1)
        scores = (self.query(x)[:, None] * self.key(slots)).sum(2) / math.sqrt(slots.shape[2])
        answer = (torch.softmax(scores, 1)[:, :, None] * self.value(slots)).sum(1)
        return torch.cat((x, answer), 1)
