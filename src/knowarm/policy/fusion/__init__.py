"""Activations and knowledge go in; activations that know come out, at one of four places."""

from knowarm.policy.config import FusionName, PolicyConfig
from knowarm.policy.fusion.attention import Attention
from knowarm.policy.fusion.base import Fusion
from knowarm.policy.fusion.concatenation import AfterLSTM, BeforeFC, BeforeLSTM, CriticOnly
from knowarm.policy.fusion.film import FiLM

FUSIONS: dict[FusionName, type[Fusion]] = {
    "none": Fusion,
    "before_fc": BeforeFC,
    "before_lstm": BeforeLSTM,
    "after_lstm": AfterLSTM,
    "film": FiLM,
    "attention": Attention,
    "critic": CriticOnly,
}

__all__ = ["FUSIONS", "Fusion", "PolicyConfig"]
