"""Recurrent policy: image encoder, knowledge fusion, LSTM, actor and critic heads.

Modules in the order of the forward pass: `config` (choices and shapes), `encoder`, `fusion`,
`lstm` (with `lstm_kernels`), `policy`, `actions`, `agent`.
"""

from knowarm.policy.agent import PolicyAgent
from knowarm.policy.config import PolicyConfig, PolicyShape
from knowarm.policy.lstm import State
from knowarm.policy.policy import (
    MatmulPrecision,
    Policy,
    PolicySpec,
    matched_without_knowledge,
)

__all__ = [
    "MatmulPrecision",
    "Policy",
    "PolicyAgent",
    "PolicyConfig",
    "PolicyShape",
    "PolicySpec",
    "State",
    "matched_without_knowledge",
]
