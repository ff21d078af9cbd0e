"""Encoder of grounding networks: scores objects and colours at every place of an image."""

from typing import cast

import torch
from torch import Tensor, nn
from torch.nn.functional import logsigmoid

from knowarm.perception.config import Facets
from knowarm.perception.looks import attribute_codes, code_matrix
from knowarm.policy.encoder import RELU_GAIN, orthogonal
from knowarm.seeding import torch_generator


class PlaceEncoder(nn.Module):
    """Four convolutions and two linear heads that score objects and colours at every place.

    The features of a place are ``channels``, and the image has one at every fourth pixel.

    A facet's score is the logarithm of the sum over places of exp(object + colour), so that object
    and colour are found at one place.

    Objects that templates make are scored by their attributes, so that one of a new kind has one,
    too: at a place each attribute has a probability of its own, and a name the product of those of
    its attributes (Lampert et al. 2009, direct prediction), normalized over all names. Normalized
    over the names of training, attributes that only others combine would have no bound.
    """

    facet_parts: Tensor
    """(2, F) buffer, object and colour of each facet; see `number_facets`."""
    code: Tensor | None
    """(objects, outputs) buffer; see `AttributeCode`. None: each object has its own score."""

    def __init__(self, facets: Facets, channels: int, seed: int) -> None:
        super().__init__()
        self.channels = channels
        self.register_buffer("facet_parts", number_facets(facets), persistent=False)
        objects, colours = (self.facet_parts.amax(1) + 1).tolist()
        codes = attribute_codes(list(dict(facets)))  # dict: each name once
        code = None
        if codes is not None:
            code = torch.from_numpy(code_matrix(codes))
            self.attributes = codes[0].attributes
            self.exclusive = codes[0].exclusive
            objects = code.shape[1]
        self.register_buffer("code", code, persistent=False)
        # Two strides of 2: one feature at every fourth pixel
        quarter = channels // 4
        half = channels // 2
        layers = (
            nn.Conv2d(3, quarter, 5, stride=2, padding=2),
            nn.Conv2d(quarter, half, 3, stride=2, padding=1),
            nn.Conv2d(half, channels, 3, padding=1),
            nn.Conv2d(channels, channels, 3, padding=1),
        )
        self.layers = nn.ModuleList(layers)
        self.objects = nn.Conv2d(channels, objects, 1)
        self.colours = nn.Conv2d(channels, colours, 1)
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
        """Return logits of objects (n, objects, P) and colours (n, colours, P) at P places.

        Those of a code are log-probabilities: of object and place, and of the colour there.
        """
        objects = self.objects(features).flatten(2)
        colours = self.colours(features).flatten(2)
        if self.code is None:
            return objects, colours
        # An attribute's logit z has the log-probability z / 2 where the code is 1 and -z / 2 where
        # it is -1, but for a constant.
        count = self.attributes
        names = self.code[:, :count] @ objects[:, :count] / 2
        place = objects[:, count, None].log_softmax(2)
        return names.log_softmax(1) + place, colours.log_softmax(1)

    def scores_by_place(self, features: Tensor) -> Tensor:
        """Score the facets at every place, (n, F, P) float32: their object's logit and colour's."""
        objects, colours = self.logits(features)
        object_of, colour_of = self.facet_parts
        return objects[:, object_of] + colours[:, colour_of]

    def facet_scores(self, features: Tensor) -> Tensor:
        """Score the facets over all places of `features`: (n, F) float32."""
        objects, colours = self.logits(features)
        # The sum over places of exp(object + colour) of all pairs is a product of two matrices; the
        # largest logits are taken out, so that no exponential overflows.
        largest_object = objects.amax((1, 2), keepdim=True)
        largest_colour = colours.amax((1, 2), keepdim=True)
        of_objects = (objects - largest_object).exp()
        of_colours = (colours - largest_colour).exp()
        sums = of_objects @ of_colours.transpose(1, 2)
        tiny = torch.finfo(sums.dtype).tiny
        scores = sums.clamp(min=tiny).log() + largest_object + largest_colour
        return scores[:, *self.facet_parts]

    def facet_likelihood(
        self, features: Tensor, facets: Tensor, places: Tensor
    ) -> Tensor:
        """Return the log-probability of facets at places, (n, m) float32.

        Among all facets at all places; of a code, that of its columns and place.

        Args:
            features: (n, C, h, w).
            facets: (n, m) int64.
            places: (n, m) int64, where they are.
        """
        if self.code is not None:
            return self._attribute_likelihood(features, facets, places)
        scores = self.facet_scores(features)
        rows = torch.arange(len(places), device=places.device)[:, None]
        objects, colours = self.logits(features)
        name, colour = self.facet_parts[:, facets]
        at_place = objects[rows, name, places] + colours[rows, colour, places]
        return at_place - scores.logsumexp(1, keepdim=True)

    def _attribute_likelihood(
        self, features: Tensor, facets: Tensor, places: Tensor
    ) -> Tensor:
        """Return the log-probability of place, attributes, kind and colour of facets, (n, m).

        Names do not need the kind; learning to tell kinds apart improves the features.
        """
        assert self.code is not None
        name, colour = self.facet_parts[:, facets]
        rows = torch.arange(len(places))[:, None]
        objects = self.objects(features).flatten(2)
        colours = self.colours(features).flatten(2).log_softmax(1)
        # Columns: shapes, of which one holds; parts, each of which may; the place; kinds
        ends = (self.exclusive, self.attributes, self.attributes + 1)
        at_place = objects[rows, :, places]
        shape_score, part_score, _, kind_score = at_place.tensor_split(ends, 2)
        shape, parts, _, kind = self.code[name].tensor_split(ends, 2)
        of_place = objects[:, self.attributes].log_softmax(1).gather(1, places)
        of_shape = (shape_score.log_softmax(2) * (shape > 0)).sum(2)
        of_parts = logsigmoid(parts * part_score).sum(2)
        of_kind = (kind_score.log_softmax(2) * kind).sum(2)
        of_colour = colours[rows, colour, places]
        return cast(Tensor, of_place + of_shape + of_parts + of_kind + of_colour)


def number_facets(facets: Facets) -> Tensor:
    """Return object and colour of each facet, (2, F) int64, numbered by first appearance."""
    numbers = []
    for names in zip(*facets, strict=True):
        order = list(dict.fromkeys(names))
        numbers.append(list(map(order.index, names)))
    return torch.tensor(numbers)
