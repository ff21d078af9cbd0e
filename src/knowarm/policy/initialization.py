"""A freshly built layer goes in; the same layer with orthogonal weights comes out."""

import math

import torch
from torch import nn

RELU_GAIN = math.sqrt(2.0)


@torch.no_grad()
def orthogonal(layer: nn.Module, gain: float, generator: torch.Generator) -> None:
    """Draw every weight matrix of a layer orthogonal and set its biases to zero.

    Convolution kernels are seen as matrices (out, in * height * width). The paper
    (section 4.2.3) initializes all layers so and names no gains.
    """
    for parameter in layer.parameters(recurse=False):
        if parameter.ndim >= 2:
            nn.init.orthogonal_(parameter, gain, generator=generator)
        else:
            nn.init.zeros_(parameter)
