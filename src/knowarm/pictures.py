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

from knowarm.errors import UserError, packages_of


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


def rectified(
    image: Image.Image,
    size: int,
    fovy_deg: float,
    intrinsics: Sequence[float],
    distortion: Sequence[float],
) -> Image.Image:
    """Return what a pinhole camera of a field of view sees, from an image of a real camera.

    Args:
        image: of the real camera.
        size: width and height of the result [px].
        fovy_deg: its field of view [deg].
        intrinsics: fx, fy, cx and cy of the real camera, in heights of its images.
        distortion: k1, k2, p1, p2 and k3 of OpenCV, or none.
    """
    with packages_of("camera", "Rectifying images"):
        import cv2
    x, y, centre_x, centre_y = np.array(intrinsics) * image.height
    # OpenCV counts from the middle of the first pixel.
    matrix = np.array([[x, 0, centre_x - 0.5], [0, y, centre_y - 0.5], [0, 0, 1]])
    side = max(1, round(image.height / size)) * size
    length = side / 2 / np.tan(np.radians(fovy_deg) / 2)
    middle = (side - 1) / 2
    wanted = np.array([[length, 0, middle], [0, length, middle], [0, 0, 1]])
    lens = np.array([*distortion] or [0.0] * 5)
    maps = cv2.initUndistortRectifyMap(
        matrix, lens, None, wanted, (side, side), cv2.CV_32FC1
    )
    fine = cv2.remap(np.asarray(image), *maps, cv2.INTER_LINEAR)
    return central_square(Image.fromarray(fine), size)
