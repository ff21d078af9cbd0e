"""Policy configuration: the user's choices, the shapes of the task, and the layer widths."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Literal

from knowarm.config import check_values
from knowarm.errors import Argument, UserError, unknown_name
from knowarm.ranges import within

if TYPE_CHECKING:
    from knowarm.policy.fusion import Fusion, Layer

# The functions import torch, which reading a config does not need.


def _no_fusion(*sizes: int) -> "Fusion":
    from knowarm.policy.fusion import Fusion

    return Fusion(*sizes)


def _concatenation(*sizes: int, layers: "tuple[Layer, ...]") -> "Fusion":
    from knowarm.policy.fusion import Concatenation

    return Concatenation(*sizes, layers=layers)


def _film(*sizes: int) -> "Fusion":
    from knowarm.policy.fusion import FiLM

    return FiLM(*sizes)


def _attention(*sizes: int) -> "Fusion":
    from knowarm.policy.fusion import Attention

    return Attention(*sizes)


def _similarity(*sizes: int) -> "Fusion":
    from knowarm.policy.fusion import Similarity

    return Similarity(*sizes)


FUSIONS: "dict[str, Callable[[int, int, int], Fusion]]" = {
    "none": _no_fusion,
    "before_fc": partial(_concatenation, layers=("fc",)),
    "before_lstm": partial(_concatenation, layers=("lstm",)),
    "after_lstm": partial(_concatenation, layers=("actor", "critic")),
    "film": _film,
    "attention": _attention,
    "similarity": _similarity,
    "critic": partial(_concatenation, layers=("critic",)),
}
"""Fusions by name, as `PolicyConfig.fusion` gives it; made from the numbers of image features, of
knowledge values and of slots. With "before_lstm" (the paper, section 4.2.2)
the knowledge is next to the LSTM's other inputs; with "critic" the actor needs none in use."""


@dataclass(frozen=True, kw_only=True)
class PolicyConfig:
    """Choices of a recurrent policy (paper section 4.2.2).

    Sizes that follow from the robot, the image and the knowledge are in `PolicyShape`.

    Raises:
        UserError: unknown fusion, or a size that is not positive.
    """

    fusion: str = "before_lstm"
    """Where the knowledge vector enters the network: none, before_fc, before_lstm (the paper),
    after_lstm, film, attention, similarity or critic."""
    hidden: Literal["grow", "fixed"] | int = "grow"
    """Hidden size of the LSTM: "grow" is ``features`` plus the width of the knowledge vector (the
    paper's 128 / 278 / 428), "fixed" is ``features``, or a number."""
    features: int = 128
    """Output width of the fully connected layer after the convolutions."""
    knowledge_encoder: Literal["identity", "learned"] = "identity"
    """Layer between knowledge vector and fusion: none, or a trained linear map."""
    wide: bool = False
    """Capacity control: no knowledge input, but an LSTM so large that the policy has as many
    parameters as the same one with knowledge."""
    pixel_shift: float = 0.0
    """Subtracted from the pixels after scaling them to 0..1."""
    pixel_scale: float = 1.0
    """Factor applied after the shift; .5 and 4 give images mean 0 and standard deviation ~1."""
    fc_activation: Literal["relu", "none"] = "relu"
    """Activation after the fully connected layer; the lineage of the paper's A3C has none."""
    actor_gain: float = 0.01
    """Gain of the orthogonal initialization of the actor heads: with .01 the first policy is near
    uniform. The paper's A3C has 1."""

    def __post_init__(self) -> None:
        if self.fusion not in FUSIONS:
            raise unknown_name("fusion", self.fusion, FUSIONS)
        check_values(self)


@dataclass(frozen=True, kw_only=True)
class PolicyShape:
    """Input and output sizes of a policy, given by robot, image and knowledge table.

    Raises:
        UserError: a size out of range.
    """

    joints: int
    """Number of joints J; one softmax head per joint."""
    levels: int = 7
    """Number of levels A of an action: increments that a joint chooses from."""
    image_size: int = 64
    """Height and width of the image [px]."""
    knowledge_dim: int = 0
    """Length K of the knowledge vector; 0 without knowledge."""
    knowledge_slots: int = 1
    """Number of equally wide parts (slots) that make up the knowledge vector."""

    def __post_init__(self) -> None:
        check_values(self)
        within(self, 20, 4096, "image_size")  # for the two convolutions


def hidden_size(config: PolicyConfig, shape: PolicyShape) -> int:
    """Compute the hidden size of the LSTM, and check the sizes of the knowledge."""
    if config.fusion != "none" and shape.knowledge_dim == 0:
        raise UserError(
            f"fusion {config.fusion!r} needs a knowledge vector and knowledge_dim is 0; pass a "
            "knowledge table with at least one column, or ",
            Argument("policy.fusion", "none"),
            ".",
        )
    if shape.knowledge_dim % shape.knowledge_slots:
        raise UserError(
            f"knowledge_slots ({shape.knowledge_slots}) must divide the width of the knowledge "
            f"vector ({shape.knowledge_dim})."
        )
    if isinstance(config.hidden, int):
        return config.hidden
    if config.hidden == "grow" and config.fusion != "none":
        return config.features + shape.knowledge_dim
    return config.features
