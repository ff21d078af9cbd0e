"""Pictures (N, H, W, C) uint8 go in; convolution features (N, positions * channels) come out."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn


class ImageEncoder(nn.Module):
    """Two convolutions: 3x3 stride 4 (3 -> 16) and 5x5 stride 2 (16 -> 32), each with a ReLU.

    A 64x64 picture gives 6 x 6 positions of 32 channels: 1152 features (paper section 4.2.2).
    """

    channels = 32

    def __init__(self, image_size: int, pixel_shift: float = 0.0, pixel_scale: float = 1.0) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, 16, 3, stride=4)
        self.conv2 = nn.Conv2d(16, self.channels, 5, stride=2)
        self.pixel_shift = pixel_shift
        self.pixel_scale = pixel_scale
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
        weight = self.conv1.weight.permute(0, 2, 3, 1).reshape(self.conv1.out_channels, -1)
        weight = weight * (self.pixel_scale / 255)
        bias = self.conv1.bias
        assert bias is not None
        if self.pixel_shift:
            bias = bias - self.pixel_shift * 255 * weight.sum(1)
        # The first convolution's windows do not overlap and leave out 7 of 16 pixels: as a matrix
        # product over the windows it converts fewer pixels and leaves the channels last, the
        # order in which the second convolution is fastest.
        windows = image.unfold(1, 3, 4).unfold(2, 3, 4).permute(0, 1, 2, 4, 5, 3)
        count, side = windows.shape[0], windows.shape[1]
        pixels = windows.reshape(count * side * side, weight.shape[1])
        x = torch.relu(F.linear(pixels.to(self.pixel_type()), weight, bias))
        x = x.view(count, side, side, -1).permute(0, 3, 1, 2)
        x = torch.relu(self.conv2(x))
        return x.permute(0, 2, 3, 1).reshape(count, self.width)

    def pixel_type(self) -> torch.dtype:
        """Type the pixels are converted to: that of the products, which saves a conversion."""
        if torch.is_autocast_enabled("cpu"):
            return torch.get_autocast_dtype("cpu")
        return self.conv1.weight.dtype
