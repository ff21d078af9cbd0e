"""Encoder of facts: reads a query's subgraph by attention, trained with what uses it."""

import math

import torch
from torch import Tensor, nn

from knowarm.questions import FACTS


class FactEncoder(nn.Module):
    """Sums the facts of a slot that matter for what it describes, as one vector.

    Row f of a slot has the vectors of head, relation and tail, ``h_f = relu(W x_f)``; row 0 is the
    condition of a query, without head. ``m = sum_f sigmoid(q(h_0) . k(h_f) / sqrt(d)) v(h_f)`` over
    the facts that there are, with four heads of attention, and the result is a function of
    ``(h_0, m)`` with one hidden layer. With words of 50 numbers it has 110,000 parameters.

    Args:
        knowledge: numbers of a slot.
        width: numbers of the result.
    """

    hidden, heads = 128, 4

    def __init__(self, knowledge: int, width: int) -> None:
        super().__init__()
        size = self.hidden
        self.fact = nn.Linear(knowledge // FACTS, size)
        self.query, self.key, self.value = (nn.Linear(size, size) for _ in range(3))
        self.joint, self.result = nn.Linear(2 * size, size), nn.Linear(size, width)

    def forward(self, knowledge: Tensor) -> Tensor:
        """Encode slots: (..., FACTS * 3 D) -> (..., width)."""
        rows = knowledge.unflatten(-1, (FACTS, -1))
        facts = torch.relu(self.fact(rows))
        asked = facts[..., 0, :]
        query = self.query(asked).unflatten(-1, (self.heads, -1))  # (..., heads, d)
        key, value = (
            layer(facts).unflatten(-1, (self.heads, -1)) for layer in (self.key, self.value)
        )
        scores = (query[..., None, :, :] * key).sum(-1) / math.sqrt(query.shape[-1])
        gate = scores.sigmoid() * (rows != 0).any(-1, keepdim=True)  # (..., FACTS, heads)
        found = (gate[..., 1:, :, None] * value[..., 1:, :, :]).sum(-3).flatten(-2)
        result: Tensor = self.result(torch.relu(self.joint(torch.cat((asked, found), -1))))
        return result
