"""Knowledge fusion: the places where the knowledge vector enters the network.

A fusion is a subclass of `Fusion` and an entry of `knowarm.policy.config.FUSIONS`.
"""

from math import sqrt
from typing import ClassVar, Literal

import torch
from torch import Tensor, nn

from knowarm.policy.encoder import RELU_GAIN, ImageEncoder, orthogonal

Layer = Literal["fc", "lstm", "actor", "critic"]
"""Layers whose input a fusion can change: fully connected layer, LSTM, actor heads, critic."""


class Fusion(nn.Module):
    """No fusion of K values of knowledge with F features; the base class of all others."""

    gains: ClassVar[dict[str, float]] = {}
    """Gains of the orthogonal initialization of the fusion's own layers, by name."""

    def __init__(self, features: int, knowledge: int, slots: int) -> None:
        super().__init__()
        self.knowledge = knowledge
        self.slots = slots

    def reset_parameters(self, generator: torch.Generator) -> None:
        """Initialize the fusion's own layers."""
        for name, gain in self.gains.items():
            orthogonal(self.get_submodule(name), gain, generator)

    def extra_inputs(self, layer: Layer) -> int:
        """Return the number of inputs that the fusion adds to a layer."""
        return 0

    def forward(self, layer: Layer, x: Tensor, knowledge: Tensor) -> Tensor:
        """Combine the activations before a layer, (N, width), with the knowledge, (N, K).

        Returns:
            (N, width + extra inputs of the layer).
        """
        return x


class Concatenation(Fusion):
    """Concatenate the knowledge to the inputs of ``layers``."""

    def __init__(
        self,
        features: int,
        knowledge: int,
        slots: int,
        *,
        layers: tuple[Layer, ...],
    ) -> None:
        super().__init__(features, knowledge, slots)
        self.layers = layers

    def extra_inputs(self, layer: Layer) -> int:
        """As `Fusion.extra_inputs`."""
        if layer not in self.layers:
            return 0
        return self.knowledge

    def forward(self, layer: Layer, x: Tensor, knowledge: Tensor) -> Tensor:
        """As `Fusion.forward`."""
        if layer not in self.layers:
            return x
        return torch.cat((x, knowledge), 1)


class FiLM(Fusion):
    """Feature-wise linear modulation of the second convolution's channels.

    ``x[p, c] -> (1 + gamma_c(k)) x[p, c] + beta_c(k)`` at every position p (Perez et al. 2018,
    with the 1 added so that the initial network is nearly unmodulated).
    """

    gains: ClassVar = {"modulation": 0.1}

    def __init__(self, features: int, knowledge: int, slots: int) -> None:
        super().__init__(features, knowledge, slots)
        self.modulation = nn.Linear(knowledge, 2 * ImageEncoder.channels)

    def forward(self, layer: Layer, x: Tensor, knowledge: Tensor) -> Tensor:
        """Modulate the convolution features: (N, positions * channels), (N, K) -> the same."""
        if layer != "fc":
            return x
        gamma, beta = self.modulation(knowledge)[:, None].chunk(2, 2)
        return torch.addcmul(beta, 1 + gamma, _positions(x)).flatten(1)


class Attention(Fusion):
    """Cross-attention from the image features to the slots of the knowledge.

    ``q = W_q x``, ``k_s = W_k slot_s``, ``v_s = W_v slot_s``; the attention output
    ``sum_s softmax_s(q . k_s / sqrt(d)) v_s`` is concatenated to the LSTM's inputs.
    """

    gains: ClassVar = {"query": 1.0, "key": 1.0, "value": 1.0}

    def __init__(self, features: int, knowledge: int, slots: int) -> None:
        super().__init__(features, knowledge, slots)
        width = knowledge // slots
        self.query = nn.Linear(features, width)
        self.key = nn.Linear(width, width)
        self.value = nn.Linear(width, width)

    def extra_inputs(self, layer: Layer) -> int:
        """As `Fusion.extra_inputs`."""
        if layer != "lstm":
            return 0
        return self.knowledge // self.slots

    def forward(self, layer: Layer, x: Tensor, knowledge: Tensor) -> Tensor:
        """Attend to the slots before the LSTM: (N, F), (N, K) -> (N, F + K / slots)."""
        if layer != "lstm":
            return x
        slots = knowledge.unflatten(1, (self.slots, -1))
        products = self.query(x)[:, None] * self.key(slots)
        scores = products.sum(2) / sqrt(slots.shape[2])
        weights = torch.softmax(scores, 1)[:, :, None]
        mixture = (weights * self.value(slots)).sum(1)
        return torch.cat((x, mixture), 1)


class Similarity(Fusion):
    """Attention over the feature map: the knowledge scores the positions of the image.

    ``e_p = sum_s (W_q slot_s) . key(x_p) / sqrt(D)``, ``a = softmax(e)`` over the P positions, and
    ``x_p -> (1 + P a_p) / 2 x_p``: positions whose features match all slots are amplified before
    the fully connected layer, and the others keep half of theirs, so that the arm remains visible.
    ``key`` has a hidden layer, without which objects of any colour and colours of any object
    compete for the same channels. A slot of zeros, such as a condition that a query does not have,
    changes nothing.
    """

    gains: ClassVar = {"query": 1.0, "key.0": RELU_GAIN, "key.2": 1.0}
    width = 64
    """D, dimensions in which knowledge and positions are compared."""

    def __init__(self, features: int, knowledge: int, slots: int) -> None:
        super().__init__(features, knowledge, slots)
        self.query = nn.Linear(knowledge // slots, self.width, bias=False)
        self.key = nn.Sequential(
            nn.Linear(ImageEncoder.channels, 2 * self.width),
            nn.ReLU(),
            nn.Linear(2 * self.width, self.width),
        )

    def forward(self, layer: Layer, x: Tensor, knowledge: Tensor) -> Tensor:
        """Weight the convolution features: (N, positions * channels), (N, K) -> the same."""
        if layer != "fc":
            return x
        maps = _positions(x)
        weights = torch.softmax(self.scores(maps, knowledge), 1) * maps.shape[1]
        shares = 0.5 + 0.5 * weights[:, :, None]
        return (maps * shares).flatten(1)

    def scores(self, maps: Tensor, knowledge: Tensor) -> Tensor:
        """Compute the similarity of positions (N, P, C) to the knowledge (N, K): (N, P)."""
        slots = knowledge.unflatten(1, (self.slots, -1))
        query = self.query(slots).sum(1)
        return (self.key(maps) * query[:, None]).sum(2) / sqrt(self.width)


def _positions(x: Tensor) -> Tensor:
    """Return convolution features (N, P C) by position, (N, P, C)."""
    return x.unflatten(1, (-1, ImageEncoder.channels))
