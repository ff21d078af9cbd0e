"""Image encoder: two convolutions over patches of the image, and orthogonal initialization."""

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from knowarm.cores import torch_threads

SIDE, STRIDE = 3, 4
"""Kernel size and stride of the first convolution [px]: its patches do not overlap and leave out
7 of every 16 pixels."""

RELU_GAIN = math.sqrt(2.0)
"""Initialization gain of layers that are followed by a ReLU."""


def orthogonal_(weight: Tensor, gain: float, generator: torch.Generator) -> None:
    """Initialize a weight matrix orthogonally, with the same bytes on any number of cores.

    With two threads the factorization of a policy's matrices also takes thirty times as long.
    """
    with torch_threads(1):
        nn.init.orthogonal_(weight, gain, generator=generator)


@torch.no_grad()
def orthogonal(layer: nn.Module, gain: float, generator: torch.Generator) -> None:
    """Initialize every weight matrix of a layer orthogonally and its biases with zeros.

    Convolution kernels are treated as matrices (out, in * height * width). The paper (section
    4.2.3) initializes all layers this way and gives no gains.
    """
    for parameter in layer.parameters(recurse=False):
        if parameter.ndim >= 2:
            orthogonal_(parameter, gain, generator)
        else:
            nn.init.zeros_(parameter)


class ImageEncoder(nn.Module):
    """Two convolutions: 3x3 stride 4 (3 -> 16) and 5x5 stride 2 (16 -> 32), each with a ReLU.

    A 64x64 image gives 6 x 6 positions of 32 channels: 1152 features (paper section 4.2.2). Pixels
    are scaled to 0..1, then shifted and scaled as in `PolicyConfig`.

    `patches` gathers the pixels that the first convolution reads, in the order it reads them. It
    has no parameters, so a rollout stores its result for all passes. `forward` is one matrix
    product over the patches and one convolution: four neighbouring patches form a block, and over
    blocks with the channels of their four patches the second convolution is one of 3x3 and stride
    1, which takes two thirds of the time on CPUs (docs/lab-notes.md).

    Attributes:
        patch_shape: (S, L), shape of one image's patches: S blocks of L pixel values.
        width: number of output features.
    """

    channels = 32

    def __init__(self, image_size: int, pixel_shift: float = 0.0, pixel_scale: float = 1.0) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, 16, SIDE, stride=STRIDE)
        self.conv2 = nn.Conv2d(16, self.channels, 5, stride=2)
        self.pixel_shift = pixel_shift
        self.pixel_scale = pixel_scale
        side = ((image_size - SIDE) // STRIDE + 1 - 5) // 2 + 1
        self.width = side * side * self.channels
        self._blocks = side + 2
        self.patch_shape = (self._blocks**2, 4 * SIDE * SIDE * 3)
        # The last patch of the last block may extend beyond the image; its weights are zero.
        self._padding = max(0, STRIDE * (2 * self._blocks - 1) + SIDE - image_size)

    def patches(self, image: Tensor) -> Tensor:
        """Gather the patches of the first convolution: (..., H, W, 3) uint8 -> (..., S, L) uint8.

        Blocks are in row-major order, each of 2 x 2 patches of 3 x 3 pixels with 3 colour channels.
        """
        blocks, leading = self._blocks, image.shape[:-3]
        image = image.reshape(-1, *image.shape[-3:])
        if self._padding:
            image = F.pad(image, (0, 0, 0, self._padding, 0, self._padding))
        cut = image.unfold(1, SIDE, STRIDE).unfold(2, SIDE, STRIDE)[:, : 2 * blocks, : 2 * blocks]
        cut = cut.unflatten(2, (blocks, 2)).unflatten(1, (blocks, 2))
        # axes: row, row in block, column, column in block, colour, pixel row, pixel column
        return cut.permute(0, 1, 3, 2, 4, 6, 7, 5).reshape(*leading, *self.patch_shape)

    def forward(self, patches: Tensor) -> Tensor:
        """Encode patches (N, S, L) uint8 as features (N, width) float32.

        The channels of one position are contiguous.
        """
        count, blocks, depth = patches.shape[0], self._blocks, self.conv1.out_channels
        # Scale the few weights instead of the many pixels.
        weight = self.conv1.weight.permute(0, 2, 3, 1).reshape(depth, -1)
        weight = weight * (self.pixel_scale / 255)
        bias = self.conv1.bias
        assert bias is not None
        if self.pixel_shift:
            bias = bias - self.pixel_shift * 255 * weight.sum(1)
        # Pixels are converted directly to the dtype of the product.
        low = torch.is_autocast_enabled(weight.device.type)
        dtype = torch.get_autocast_dtype(weight.device.type) if low else weight.dtype
        pixels = patches.reshape(-1, weight.shape[1]).to(dtype)
        x = torch.relu(F.linear(pixels, weight, bias))
        # Channels last is the layout of the product, and the fastest one for convolutions.
        x = x.view(count, blocks, blocks, 4 * depth).permute(0, 3, 1, 2)
        x = torch.relu(F.conv2d(x, self._block_weight(), self.conv2.bias))
        return x.permute(0, 2, 3, 1).reshape(count, self.width)

    def _block_weight(self) -> Tensor:
        """Rearrange the second kernel for blocks: (32, 16, 5, 5) -> (32, 64, 3, 3)."""
        weight = F.pad(self.conv2.weight, (0, 1, 0, 1))
        out, depth = weight.shape[:2]
        weight = weight.view(out, depth, 3, 2, 3, 2).permute(0, 3, 5, 1, 2, 4)
        return weight.reshape(out, 4 * depth, 3, 3)
