"""Comparison of images: structural similarity, and the distance between silhouettes."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, gaussian_filter


def ssim(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> float:
    """Structural similarity (Wang et al. 2004), Gaussian window of 1.5 pixels, channel mean."""
    values = []
    for channel in range(3):
        x, y = (image[..., channel].astype(np.float64) for image in (a, b))
        mean_x, mean_y = gaussian_filter(x, 1.5), gaussian_filter(y, 1.5)
        var_x = gaussian_filter(x * x, 1.5) - mean_x**2
        var_y = gaussian_filter(y * y, 1.5) - mean_y**2
        cov = gaussian_filter(x * y, 1.5) - mean_x * mean_y
        c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
        score = (2 * mean_x * mean_y + c1) * (2 * cov + c2)
        values.append(
            (score / ((mean_x**2 + mean_y**2 + c1) * (var_x + var_y + c2))).mean()
        )
    return float(np.mean(values))


def stray_share(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> float:
    """Return the share of pixels of silhouettes (n, H, W) more than a pixel from the other's."""
    square = np.ones((1, 3, 3), dtype=np.bool_)
    stray = (a & ~binary_dilation(b, square)) | (b & ~binary_dilation(a, square))
    return float(stray.mean())
