"""Line reader for large text files, plain or compressed, with a limit on the line length."""

import bz2
import gzip
import lzma
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any, cast

from knowarm.errors import UserError

MAX_LINE = 1 << 20
"""Longest line in bytes; a file with a longer one is not line-based."""

READ_ERRORS = (EOFError, OSError, lzma.LZMAError, zlib.error, zipfile.BadZipFile)
"""Errors of reading a file that is incomplete or not compressed as its suffix says."""


def open_bytes(path: Path) -> IO[bytes]:
    """Open a file for reading bytes, decompressing .gz, .bz2, .xz and .zip (with one member)."""
    suffix = path.suffix.lower()
    if suffix == ".zip":
        archive = zipfile.ZipFile(path)
        if len(names := archive.namelist()) != 1:
            raise UserError(
                f"{path} must contain one file, but contains {', '.join(names[:6]) or 'none'}. "
                f"Unpack it and give the path of the file."
            )
        return archive.open(names[0])
    openers: dict[str, Callable[..., Any]] = {".gz": gzip.open, ".bz2": bz2.open, ".xz": lzma.open}
    return cast(IO[bytes], openers.get(suffix, open)(path, "rb"))


def byte_lines(path: Path) -> Iterator[tuple[int, bytes]]:
    """Yield (line number, line without its end) of a file.

    Raises:
        UserError: a line is longer than `MAX_LINE`, so that a file of many gigabytes without a
            line end takes no memory; or the file cannot be decompressed.
    """
    number = 0
    try:
        with open_bytes(path) as file:
            while line := file.readline(MAX_LINE + 1):
                number += 1
                if len(line) > MAX_LINE:
                    raise UserError(
                        f"{path}, line {number}: the line is longer than {MAX_LINE:,} bytes, so "
                        f"the file does not hold one record per line. Check the format."
                    )
                yield number, line.rstrip(b"\r\n")
    except READ_ERRORS as error:
        raise unreadable(path, error) from error


def text_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield (line number, text without its end) of a UTF-8 file.

    Raises:
        UserError: a line is too long or is not UTF-8.
    """
    return ((number, decode(line, path, number)) for number, line in byte_lines(path))


def decode(line: bytes, path: Path, number: int) -> str:
    """Decode one line.

    Raises:
        UserError: it is not UTF-8, or contains a zero byte.
    """
    try:
        text = line.decode()
    except UnicodeDecodeError as error:
        raise UserError(
            f"{path}, line {number}: not UTF-8 ({error.reason} at byte {error.start}). "
            f"Convert the file, e.g. `iconv -f latin1 -t utf-8`."
        ) from error
    if "\0" in text:
        raise UserError(
            f"{path}, line {number}: contains a zero byte, so this is not a text file. "
            f"Check the path and the format."
        )
    return text.removeprefix("\ufeff") if number == 1 else text


def unreadable(path: Path, error: Exception) -> UserError:
    """Return the error for a file that cannot be read or decompressed."""
    return UserError(
        f"{path}: the file cannot be read or decompressed: {error}. Copy or compress it again."
    )
