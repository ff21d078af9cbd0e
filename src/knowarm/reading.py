"""Reading of stored files: every defect becomes one kind of error, with place and remedy."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import load

from knowarm.errors import UserError

MAX_JSON = 64 * 2**20
"""Largest JSON or text file that is read whole [bytes]; what KnowArm writes is far smaller."""


class UnreadableFileError(UserError):
    """A stored file is missing, incomplete, damaged, or of another format."""


@contextmanager
def reading(path: Path, remedy: str) -> Iterator[None]:
    """Turn whatever damaged content raises in a ``with`` block into an `UnreadableFileError`.

    The libraries that decode files raise many types of errors, most of them undocumented, and
    those written in Rust panics that are no `Exception`. Put only the decoding of one file into the
    block, so that no mistake of the program is taken for a damaged file.

    Args:
        path: the file, for the message.
        remedy: what to do, a sentence.

    Raises:
        UnreadableFileError: the block raised anything but a `UserError` or an interrupt.
    """
    try:
        yield
    except UserError:
        raise
    except OSError as error:
        reason = error.strerror or one_line(error)
        raise UnreadableFileError(f"Cannot read {path}: {reason}. {remedy}") from error
    except BaseException as error:
        if isinstance(error, Exception) or type(error).__name__ == "PanicException":
            raise UnreadableFileError(
                f"{path} is damaged or of another format: {one_line(error)}. {remedy}"
            ) from error
        raise


def one_line(error: BaseException) -> str:
    """Return the reason that an exception gives, on one line of at most 300 characters."""
    text = " ".join(str(error).split()).rstrip(".") or type(error).__name__
    text = f"missing {text}" if isinstance(error, KeyError) else text
    return text if len(text) <= 300 else text[:297] + "..."


def read_text(path: Path, *, remedy: str, most: int = MAX_JSON) -> str:
    """Read a UTF-8 text file of at most ``most`` bytes.

    Raises:
        UnreadableFileError: it is missing, larger, or not UTF-8.
    """
    with reading(path, remedy):
        with path.open("rb") as file:
            data = file.read(most + 1)
        if len(data) > most:
            raise ValueError(f"it is larger than {most / 2**20:.0f} MiB")
        return data.decode()


def read_json(
    path: Path, *, remedy: str = "Restore the file, or give another one."
) -> dict[str, Any]:
    """Read a JSON object.

    Raises:
        UnreadableFileError: the file is missing, not JSON, nested too deeply, or no object.
    """
    text = read_text(path, remedy=remedy)
    try:
        values = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise UnreadableFileError(
            f"{path} is not valid JSON: {one_line(error)}. {remedy}"
        ) from error
    if not isinstance(values, dict):
        raise UnreadableFileError(
            f"{path} must hold a JSON object, got {type(values).__name__}. {remedy}"
        )
    return values


def read_arrays(path: Path, *, remedy: str) -> dict[str, np.ndarray]:
    """Read the arrays of a safetensors file by name.

    Raises:
        UnreadableFileError: the file is missing, incomplete, or no safetensors file.
    """
    with reading(path, remedy):
        return load(path.read_bytes())
