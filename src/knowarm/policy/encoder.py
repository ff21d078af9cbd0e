"""Image encoder: two convolutions over patches of the image, and orthogonal initialization."""

from math import sqrt
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.nn.grad import conv2d_input, conv2d_weight

from knowarm.cores import torch_threads

SIDE = 3
"""Kernel size of the first convolution [px]."""
STRIDE = 4
"""Its stride [px]: its patches do not overlap and leave out 7 of every 16 pixels."""

RELU_GAIN = sqrt(2.0)
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


def patch_pixels(image_size: int, blocks: int) -> Tensor:
    """Return the numbers of the pixel values that the patches of an image consist of, (S * L,).

    The order is that of `ImageEncoder.patches`. The last patch of the last block may extend beyond
    the image, and repeats its edge there; its weights are zero.
    """
    starts = STRIDE * torch.arange(2 * blocks)
    # Rows (or columns) of each patch, (2 * blocks, SIDE)
    lines = (starts[:, None] + torch.arange(SIDE)).clamp(max=image_size - 1)
    # axes: row and column of the block, those of the patch in it, those of the pixel, colour
    rows = lines.view(blocks, 1, 2, 1, SIDE, 1, 1)
    columns = lines.view(1, blocks, 1, 2, 1, SIDE, 1)
    pixels = rows * image_size + columns
    values = pixels * 3 + torch.arange(3)
    return values.flatten()


class ProductWeights(NamedTuple):
    """The parameters of an `ImageEncoder` as its two products take them."""

    first: Tensor  # (16, 27)
    first_bias: Tensor  # (16,)
    second: Tensor  # (32, 64, 3, 3), channels last
    second_bias: Tensor  # (32,)


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

    def __init__(
        self,
        image_size: int,
        pixel_shift: float = 0.0,
        pixel_scale: float = 1.0,
    ) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, 16, SIDE, stride=STRIDE)
        self.conv2 = nn.Conv2d(16, self.channels, 5, stride=2)
        self.pixel_shift = pixel_shift
        self.pixel_scale = pixel_scale
        patches_per_row = (image_size - SIDE) // STRIDE + 1
        self._side = (patches_per_row - 5) // 2 + 1  # Positions per row
        self.width = self._side**2 * self.channels
        # Blocks per row: those that 3x3 kernels at all positions read
        self._blocks = self._side + 2
        self.patch_shape = (self._blocks**2, 4 * SIDE * SIDE * 3)
        self._pixels: Tensor
        self.register_buffer(
            "_pixels", patch_pixels(image_size, self._blocks), persistent=False
        )

    def patches(self, image: Tensor) -> Tensor:
        """Gather the patches of the first convolution: (..., H, W, 3) uint8 -> (..., S, L) uint8.

        Blocks are in row-major order, each of 2 x 2 patches of 3 x 3 pixels with 3 colour channels.
        """
        values = image.flatten(-3)
        if image.device.type == "cpu" and not torch.compiler.is_exporting():
            # NumPy gathers bytes four times as fast as PyTorch.
            patches = torch.from_numpy(values.numpy().take(self._pixels.numpy(), -1))
        else:
            patches = values.index_select(-1, self._pixels)
        return patches.view(*image.shape[:-3], *self.patch_shape)

    def forward(self, patches: Tensor) -> Tensor:
        """Encode patches (N, S, L) uint8 as features (N, width) float32.

        The channels of one position are contiguous.
        """
        weights = self.product_weights()
        return self.second(self.first(patches, weights), weights)

    def product_weights(self) -> "ProductWeights":
        """Arrange the parameters for the products of `first` and `second`."""
        first_weight, bias = self.conv1.parameters()
        second_weight, second_bias = self.conv2.parameters()
        # Scale the few weights instead of the many pixels.
        first = first_weight.permute(0, 2, 3, 1).flatten(1) * (self.pixel_scale / 255)
        first_bias: Tensor = bias
        if self.pixel_shift:
            first_bias = bias - self.pixel_shift * 255 * first.sum(1)
        # The second kernel for blocks: (32, 16, 5, 5) -> (32, 64, 3, 3). Its 5x5 pixels become 6x6
        # by a padding of zeros, which are 3x3 blocks of 2x2.
        padded = F.pad(second_weight, (0, 1, 0, 1))
        blocks = padded.unflatten(3, (3, 2)).unflatten(2, (3, 2))
        second = blocks.permute(0, 3, 5, 1, 2, 4).flatten(1, 3)
        # Channels last is the layout of the product, and the fastest one for convolutions.
        second = second.contiguous(memory_format=torch.channels_last)
        return ProductWeights(first, first_bias, second, second_bias)

    def first(self, patches: Tensor, weights: "ProductWeights") -> Tensor:
        """Compute the first convolution: (N, S, L) uint8 -> (N, side, side, 64), side^2 = S."""
        weight = weights.first
        device = weight.device.type
        # Pixels are converted directly to the dtype of the product.
        dtype = weight.dtype
        if torch.is_autocast_enabled(device):
            dtype = torch.get_autocast_dtype(device)
        pixels = patches.reshape(-1, weight.shape[1]).to(dtype)
        x = torch.relu(F.linear(pixels, weight, weights.first_bias))
        return x.view(-1, self._blocks, self._blocks, 4 * self.conv1.out_channels)

    def second(self, x: Tensor, weights: "ProductWeights") -> Tensor:
        """Compute the second convolution from the result of `first`: (N, width)."""
        x = F.conv2d(x.permute(0, 3, 1, 2), weights.second, weights.second_bias)
        return torch.relu(x).permute(0, 2, 3, 1).reshape(-1, self.width)

    @torch.no_grad()
    def gradients(
        self,
        patches: Tensor,
        hidden: Tensor,
        features: Tensor,
        gradient: Tensor,
    ) -> dict[str, Tensor]:
        """Compute the gradients of the parameters, by name, from that of the features.

        Args:
            patches: (N, S, L) uint8.
            hidden: their results of `first`, (N, side, side, 64), in the dtype of the products.
            features: their results of `second`, (N, width).
            gradient: of the features, (N, width).
        """
        depth = self.conv1.out_channels
        dtype = hidden.dtype
        weight = self.product_weights().second.to(dtype)
        # Second convolution; the derivative of a ReLU is the sign of its result.
        d_second = gradient * features.sign()
        d_second = d_second.view(-1, self._side, self._side, self.channels)
        d_second_bias = d_second.sum((0, 1, 2))
        x = hidden.permute(0, 3, 1, 2)
        d_x = d_second.to(dtype).permute(0, 3, 1, 2)
        d_blocks = conv2d_weight(x, weight.shape, d_x).float()
        # Back from the kernel of blocks to that of patches
        d_blocks = d_blocks.view(-1, 2, 2, depth, 3, 3)
        d_kernel = d_blocks.permute(0, 3, 4, 1, 5, 2).reshape(-1, depth, 6, 6)
        # First convolution
        d_first = conv2d_input(x.shape, weight, d_x).mul_(x.sign())
        d_first = d_first.permute(0, 2, 3, 1).reshape(-1, depth)
        pixels = patches.reshape(len(d_first), -1).to(dtype)
        d_weight = (d_first.t() @ pixels).float()
        d_bias = d_first.float().sum(0)
        # The weights of `first` are scaled, and its bias is shifted by their sum.
        d_weight -= self.pixel_shift * 255 * d_bias[:, None]
        d_weight *= self.pixel_scale / 255
        return {
            "conv1.weight": d_weight.view(depth, SIDE, SIDE, 3).permute(0, 3, 1, 2),
            "conv1.bias": d_bias,
            "conv2.weight": d_kernel[..., :5, :5],  # the padding has no parameters
            "conv2.bias": d_second_bias,
        }
