"""Pictures (N, H, W, C) uint8 go in; convolution features (N, positions * channels) come out."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn


class ImageEncoder(nn.Module):
    """Two convolutions: 3x3 stride 4 (3 -> 16) and 5x5 stride 2 (16 -> 32), each with a ReLU.

    A 64x64 picture gives 6 x 6 positions of 32 channels: 1152 features (paper section 4.2.2).
    """

    channels = 32

    def __init__(self, image_size: int, pixel_shift: float) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, 16, 3, stride=4)
        self.conv2 = nn.Conv2d(16, self.channels, 5, stride=2)
        self.pixel_shift = pixel_shift
        side = ((image_size - 3) // 4 + 1 - 5) // 2 + 1
        self.width = side * side * self.channels

    def forward(self, image: Tensor) -> Tensor:
        """Encode pictures.

        Args:
            image: (N, H, W, 3) uint8.

        Returns:
            (N, width) float32, positions first, the channels of one position side by side.
        """
        # Scaling the few weights instead of the many pixels gives the same sums.
        weight = self.conv1.weight / 255
        bias = self.conv1.bias
        assert bias is not None
        if self.pixel_shift:
            bias = bias - self.pixel_shift * self.conv1.weight.sum((1, 2, 3))
        pixels = image.permute(0, 3, 1, 2).contiguous().to(weight.dtype)
        x = torch.relu(F.conv2d(pixels, weight, bias, stride=4))
        x = torch.relu(self.conv2(x))
        return x.permute(0, 2, 3, 1).reshape(x.shape[0], self.width)
