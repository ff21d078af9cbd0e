"""Images (N, H, W, 3) uint8 go in; their patches, then convolution features come out."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

SIDE, STRIDE = 3, 4
"""Of the first convolution's patches [px]: they do not overlap and leave out 7 of 16 pixels."""


class ImageEncoder(nn.Module):
    """Two convolutions: 3x3 stride 4 (3 -> 16) and 5x5 stride 2 (16 -> 32), each with a ReLU.

    A 64x64 image gives 6 x 6 positions of 32 channels: 1152 features (paper section 4.2.2).

    The work is cut in two. `patches` takes the pixels that the first convolution sees and puts
    them in the order it sees them; it has no parameters, so a rollout keeps its result and every
    pass over the rollout saves it. `forward` is one matrix product over the patches and a
    convolution. Four patches side by side make a block, and blocks with the channels of their
    four patches turn the second convolution into one of 3x3 and stride 1, which processors do in
    two thirds of the time (docs/learning.md).

    Attributes:
        patch_shape: (S, L), shape of one image's patches: S blocks, L pixel values of each.
        width: number of features.
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
        # The last window of the last block may reach beyond the image; its weights are zero.
        self._padding = max(0, STRIDE * (2 * self._blocks - 1) + SIDE - image_size)

    def patches(self, image: Tensor) -> Tensor:
        """Cut images into the patches of the first convolution.

        Args:
            image: (..., H, W, 3) uint8.

        Returns:
            (..., S, L) uint8: blocks row by row; in each 2 x 2 patches of 3 x 3 pixels of 3
            colours.
        """
        blocks, leading = self._blocks, image.shape[:-3]
        image = image.reshape(-1, *image.shape[-3:])
        if self._padding:
            image = F.pad(image, (0, 0, 0, self._padding, 0, self._padding))
        cut = image.unfold(1, SIDE, STRIDE).unfold(2, SIDE, STRIDE)[:, : 2 * blocks, : 2 * blocks]
        cut = cut.unflatten(2, (blocks, 2)).unflatten(1, (blocks, 2))
        # row, row in block, column, column in block, colour, pixel row, pixel column
        return cut.permute(0, 1, 3, 2, 4, 6, 7, 5).reshape(*leading, *self.patch_shape)

    def forward(self, patches: Tensor) -> Tensor:
        """Encode images.

        Args:
            patches: (N, S, L) uint8 of `patches`.

        Returns:
            (N, width) float32, positions first, the channels of one position side by side.
        """
        count, blocks, depth = patches.shape[0], self._blocks, self.conv1.out_channels
        # Scaling the few weights instead of the many pixels gives the same sums.
        weight = self.conv1.weight.permute(0, 2, 3, 1).reshape(depth, -1)
        weight = weight * (self.pixel_scale / 255)
        bias = self.conv1.bias
        assert bias is not None
        if self.pixel_shift:
            bias = bias - self.pixel_shift * 255 * weight.sum(1)
        pixels = patches.reshape(-1, weight.shape[1]).to(self.pixel_type())
        x = torch.relu(F.linear(pixels, weight, bias))
        # Channels last is the order of the product, and the one convolutions are fastest in.
        x = x.view(count, blocks, blocks, 4 * depth).permute(0, 3, 1, 2)
        x = torch.relu(F.conv2d(x, self._block_weight(), self.conv2.bias))
        return x.permute(0, 2, 3, 1).reshape(count, self.width)

    def pixel_type(self) -> torch.dtype:
        """Type the pixels are converted to: that of the products, which saves a conversion."""
        device = self.conv1.weight.device.type
        if torch.is_autocast_enabled(device):
            return torch.get_autocast_dtype(device)
        return self.conv1.weight.dtype

    def _block_weight(self) -> Tensor:
        """Weights of the second convolution over blocks: (32, 16, 5, 5) -> (32, 64, 3, 3)."""
        weight = F.pad(self.conv2.weight, (0, 1, 0, 1))
        out, depth = weight.shape[:2]
        weight = weight.view(out, depth, 3, 2, 3, 2).permute(0, 3, 5, 1, 2, 4)
        return weight.reshape(out, 4 * depth, 3, 3)
