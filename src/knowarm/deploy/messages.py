"""Messages of openpi's policy servers: msgpack with NumPy arrays, without pickle."""

import re
from typing import Any

import numpy as np

from knowarm.errors import packages_of
from knowarm.reading import one_line

with packages_of("serve", "Serving"):
    import msgpack

_DTYPE = re.compile(r"[<>|=]?[biuf]\d{1,2}")  # no objects, records or complex numbers


def pack(values: Any) -> bytes:
    """Pack values with NumPy arrays as openpi's clients read them."""
    return bytes(msgpack.packb(values, default=_pack_array))


def unpack(data: bytes | str) -> Any:
    """Unpack a message.

    Raises:
        ValueError: the message is text or damaged, or an array is not of plain numbers.
    """
    try:
        return msgpack.unpackb(data, object_hook=_unpack_array)
    except Exception as error:  # NumPy and msgpack raise many types
        raise ValueError(
            f"the message is no msgpack map of numbers and arrays: {one_line(error)}"
        ) from error


def _pack_array(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return {
            b"__ndarray__": True,
            b"data": value.tobytes(),
            b"dtype": value.dtype.str,
            b"shape": value.shape,
        }
    if isinstance(value, np.generic):
        return {
            b"__npgeneric__": True,
            b"data": value.item(),
            b"dtype": value.dtype.str,
        }
    return list(value)


def _unpack_array(value: dict[Any, Any]) -> Any:
    if b"__ndarray__" not in value and b"__npgeneric__" not in value:
        return value
    name = value[b"dtype"]
    shape = value.get(b"shape", ())
    if not _DTYPE.fullmatch(name) or min(shape, default=0) < 0:
        raise ValueError(
            f"arrays of dtype {name!r:.20} and shape {shape!r:.40} are not read"
        )
    dtype = np.dtype(name)
    if b"__npgeneric__" in value:
        return dtype.type(value[b"data"])
    return np.frombuffer(value[b"data"], dtype).reshape(shape)
