"""Image files: their formats, files in memory, and ``data:`` URIs that a page carries inside it."""

import base64
import io
from collections.abc import Sequence
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from knowarm.errors import UserError


def encode(image: NDArray[np.uint8] | Image.Image, kind: str, **options: Any) -> bytes:
    """Return a file of an image; ``kind`` and ``options`` as of Pillow's ``save``."""
    if not isinstance(image, Image.Image):
        image = Image.fromarray(image)
    stream = io.BytesIO()
    image.save(stream, kind, **options)
    return stream.getvalue()


def animation(
    images: Sequence[NDArray[np.uint8]], frame_ms: int, last_ms: int
) -> bytes:
    """Return a WebP file that repeats images; ``last_ms`` is the display time of the last one."""
    frames = [Image.fromarray(image) for image in images]
    durations = [*repeat(frame_ms, len(frames) - 1), last_ms]
    return encode(
        frames[0],
        "WEBP",
        quality=70,
        method=2,
        save_all=True,
        append_images=frames[1:],
        duration=durations,
        loop=0,
    )


def data_uri(kind: str, data: bytes) -> str:
    """Return the ``data:`` URI of an image file of a kind such as ``"PNG"``."""
    return f"data:image/{kind.lower()};base64,{base64.b64encode(data).decode()}"


def check_suffix(path: Path, what: str) -> None:
    """Raise a `UserError` unless images can be written in the format of a file's suffix."""
    if Image.registered_extensions().get(path.suffix.lower()) not in Image.SAVE:
        raise UserError(
            f"{what} is an image file such as {path.stem}.png, got {path.name!r}."
        )


def central_square(image: Image.Image, size: int) -> Image.Image:
    """Average the central square of an image to ``size`` pixels."""
    width, height = image.size
    side = min(width, height)
    left = (width - side) / 2
    top = (height - side) / 2
    return image.resize(
        (size, size), Image.Resampling.BOX, (left, top, left + side, top + side)
    )
