"""Names and sizes go in; the widths of every part of the network come out."""

from dataclasses import dataclass
from typing import Literal

from knowarm.errors import UserError

FusionName = Literal[
    "none", "before_fc", "before_lstm", "after_lstm", "film", "attention", "critic"
]


@dataclass(frozen=True, kw_only=True)
class PolicyConfig:
    """Sizes of one recurrent policy (paper section 4.2.2).

    Raises:
        UserError: a size that is not positive, knowledge that a fusion needs and does not get,
            slots that do not divide the knowledge, an image too small for the two convolutions.
    """

    joints: int
    """Number of joints; each gets its own softmax head."""

    levels: int = 7
    """Number of increments a joint chooses from."""

    image_size: int = 64
    """Height and width of the image [px]."""

    features: int = 128
    """Width of the fully connected layer after the convolutions."""

    knowledge_dim: int = 0
    """Numbers in the knowledge vector; 0 for a policy that gets none."""

    knowledge_slots: int = 1
    """Named parts of equal width that the knowledge vector is a concatenation of."""

    knowledge_encoder: Literal["identity", "learned"] = "identity"
    """What happens to the vector first: nothing, or a trained linear map."""

    knowledge_width: int | None = None
    """Width of the trained linear map; None keeps the width of the vector."""

    fusion: FusionName = "before_lstm"
    """Where the knowledge enters; ``before_lstm`` is the paper's."""

    hidden: Literal["grow", "fixed"] | int = "grow"
    """LSTM size: ``features`` plus the knowledge's width (the paper's 128 / 278 / 428), always
    ``features``, or a number."""

    pixel_shift: float = 0.0
    """Subtracted from the pixels after they were scaled to 0..1."""

    pixel_scale: float = 1.0
    """Multiplies the shifted pixels; .5 and 4 give images mean 0 and deviation about 1."""

    actor_gain: float = 0.01
    """Gain of the orthogonal initialization of the actor heads: small starts near uniform."""

    def __post_init__(self) -> None:
        for name in ("joints", "levels", "features", "knowledge_slots"):
            if getattr(self, name) < 1:
                raise UserError(f"{name} must be at least 1, got {getattr(self, name)}.")
        if self.image_size < 20:
            raise UserError(f"image_size must be at least 20, got {self.image_size}.")
        if self.knowledge_dim < 0:
            raise UserError(f"knowledge_dim must be 0 or more, got {self.knowledge_dim}.")
        if self.fusion != "none" and self.knowledge_dim == 0:
            raise UserError(
                f"fusion {self.fusion!r} needs a knowledge vector and knowledge_dim is 0; give the "
                "agent an embedding or choose fusion 'none'."
            )
        if self.knowledge_dim % self.knowledge_slots or self.encoded_width % self.knowledge_slots:
            raise UserError(
                f"knowledge_slots ({self.knowledge_slots}) must divide the knowledge's width, got "
                f"{self.knowledge_dim} numbers, {self.encoded_width} after the encoder."
            )
        if isinstance(self.hidden, int) and self.hidden < 1:
            raise UserError(f"hidden must be 'grow', 'fixed' or at least 1, got {self.hidden}.")

    @property
    def encoded_width(self) -> int:
        """Width of the knowledge after its encoder; what the fusion gets."""
        if self.knowledge_encoder == "learned" and self.knowledge_width is not None:
            return self.knowledge_width
        return self.knowledge_dim

    @property
    def hidden_size(self) -> int:
        """Size of the LSTM's hidden and cell state."""
        if isinstance(self.hidden, int):
            return self.hidden
        if self.hidden == "fixed" or self.fusion == "none":
            return self.features
        return self.features + self.encoded_width
