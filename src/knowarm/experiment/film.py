"""Images of one episode go in; a small film file comes out, and the images back."""

from pathlib import Path

import numpy as np
from PIL import Image, ImageSequence, UnidentifiedImageError

from knowarm.errors import UserError

FRAME_MS = 120
"""Time each image is shown [ms]."""

LAST_MS = 1_200
"""Time the last image is shown before the film starts again [ms]."""


def write_film(path: Path, frames: np.ndarray) -> None:
    """Write an animated WebP without loss: browsers play it, and the images come back exactly.

    Args:
        path: the file; its folder is made.
        frames: (T, H, W, 3) uint8, T at least 1.

    Raises:
        UserError: the file cannot be written.
    """
    images = [Image.fromarray(frame) for frame in frames]
    durations = [FRAME_MS] * (len(images) - 1) + [LAST_MS]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        images[0].save(
            path,
            save_all=True,
            append_images=images[1:],
            duration=durations,
            loop=0,
            lossless=True,
            method=4,
        )
    except OSError as error:
        raise UserError(f"Cannot write {path}: {error.strerror or error}.") from error


def read_film(path: Path) -> np.ndarray:
    """Images of a film written by `write_film`, (T, H, W, 3) uint8.

    Raises:
        UserError: the file is missing or no image.
    """
    frames: list[np.ndarray] = []
    try:
        with Image.open(path) as film:
            for number, frame in enumerate(ImageSequence.Iterator(film)):
                image = np.asarray(frame.convert("RGB"))
                # The encoder stores equal neighbours once and adds up their times.
                shown = int(frame.info.get("duration", 0))  # a film of one image has none
                is_last = number == getattr(film, "n_frames", 1) - 1
                extra = shown - (LAST_MS if is_last else FRAME_MS)
                frames += [image] * (1 + max(0, extra) // FRAME_MS)
        return np.stack(frames)
    except (OSError, UnidentifiedImageError) as error:
        raise UserError(f"Cannot read {path}: {error}. Evaluate the run again.") from error
