"""Temporary."""

from dataclasses import dataclass
from typing import Literal

from knowarm.policy.config import FusionName


@dataclass(frozen=True, kw_only=True)
class NetworkConfig:
    """The choices of a policy that do not follow from the robot, the image or the knowledge."""

    fusion: FusionName = "before_lstm"
    """Where the knowledge enters; ``before_lstm`` is the paper's. An agent without knowledge
    ignores it."""

    hidden: Literal["grow", "fixed"] | int = "grow"
    """LSTM size: ``grow`` adds the knowledge's width to ``features`` (the paper's 128 / 278 /
    428), ``fixed`` keeps ``features``, or a number."""

    features: int = 128
    """Width of the fully connected layer after the convolutions."""

    wide: bool = False
    """Capacity control: the knowledge is taken away, and the network is given the same LSTM size
    and number of parameters that it would have had with it."""

    pixel_shift: float = 0.0
    """Subtracted from the pixels after they were scaled to 0..1."""

    pixel_scale: float = 1.0
    """Multiplies the shifted pixels; .5 and 4 give images mean 0 and deviation about 1."""

    actor_gain: float = 0.01
    """Gain of the orthogonal initialization of the actor heads."""
