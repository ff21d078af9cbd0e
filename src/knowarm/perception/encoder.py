"""Image encoder of perception modules: features, object and colour logits of every place."""

import torch
from torch import Tensor, nn

from knowarm.policy.encoder import RELU_GAIN, orthogonal
from knowarm.questions import ObjectColour
from knowarm.seeding import torch_generator


class PlaceEncoder(nn.Module):
    """Four convolutions and two linear heads that score objects and colours at every place.

    A facet's score is the logarithm of the sum over places of exp(object + colour), so that object
    and colour are found at one place. Each convolution has inputs, outputs, kernel and stride.
    """

    facet_parts: Tensor
    """(2, F) buffer, object and colour of each facet; see `number_facets`."""

    def __init__(
        self,
        facets: tuple[ObjectColour, ...],
        convolutions: tuple[tuple[int, int, int, int], ...],
        seed: int,
    ) -> None:
        super().__init__()
        self.channels = convolutions[-1][1]
        self.register_buffer("facet_parts", parts := number_facets(facets), persistent=False)
        objects, colours = (parts.amax(1) + 1).tolist()
        self.layers = nn.ModuleList(
            nn.Conv2d(inputs, outputs, kernel, stride, padding=kernel // 2)
            for inputs, outputs, kernel, stride in convolutions
        )
        self.objects = nn.Conv2d(self.channels, objects, 1)
        self.colours = nn.Conv2d(self.channels, colours, 1)
        generator = torch_generator(seed, "perception")
        for layer in self.layers:
            orthogonal(layer, RELU_GAIN, generator)
        for layer in (self.objects, self.colours):
            orthogonal(layer, 1.0, generator)

    def features(self, images: Tensor) -> Tensor:
        """Compute the features of images (n, H, W, 3) uint8, by place: (n, C, h, w) float32."""
        x = images.permute(0, 3, 1, 2).float() / 255 - 0.5
        for layer in self.layers:
            x = torch.relu(layer(x))
        return x

    def logits(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Return logits of objects (n, objects, P) and colours (n, colours, P) at P places."""
        return self.objects(features).flatten(2), self.colours(features).flatten(2)

    def facet_scores(self, features: Tensor) -> Tensor:
        """Score the facets over all places of `features`: (n, F) float32."""
        objects, colours = self.logits(features)
        # The sum over places of exp(object + colour) of all pairs is a product of two matrices.
        most = [scores.amax((1, 2), keepdim=True) for scores in (objects, colours)]
        sums = (objects - most[0]).exp() @ (colours - most[1]).exp().transpose(1, 2)
        scores = sums.clamp(min=torch.finfo(sums.dtype).tiny).log() + most[0] + most[1]
        return scores[:, *self.facet_parts]


def number_facets(facets: tuple[ObjectColour, ...]) -> Tensor:
    """Return object and colour of each facet, (2, F) int64, numbered by first appearance."""
    columns = [(names, list(dict.fromkeys(names))) for names in zip(*facets, strict=True)]
    return torch.tensor([[order.index(name) for name in names] for names, order in columns])
