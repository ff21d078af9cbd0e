"""Image files in memory, and as ``data:`` URIs that a page carries inside it."""

import base64
import io
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image


def encode(image: NDArray[np.uint8] | Image.Image, kind: str, **options: Any) -> bytes:
    """Return a file of an image; ``kind`` and ``options`` as of Pillow's ``save``."""
    picture = image if isinstance(image, Image.Image) else Image.fromarray(image)
    stream = io.BytesIO()
    picture.save(stream, kind, **options)
    return stream.getvalue()


def data_uri(kind: str, data: bytes) -> str:
    """Return the ``data:`` URI of an image file of a kind such as ``"PNG"``."""
    return f"data:image/{kind.lower()};base64,{base64.b64encode(data).decode()}"
