"""Renderer, knowledge vectors and a recurrent state go in; actions, values and the state come out.

The path through the files: `config` -> `encoder` -> `fusion` -> `memory` -> `policy` ->
`actions` -> `agent`.
"""

from knowarm.policy.agent import PolicyAgent
from knowarm.policy.config import PolicyConfig
from knowarm.policy.matched import matched_without_knowledge
from knowarm.policy.memory import State
from knowarm.policy.policy import Policy

__all__ = ["Policy", "PolicyAgent", "PolicyConfig", "State", "matched_without_knowledge"]
