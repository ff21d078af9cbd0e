"""Line reader for large text files, plain or compressed, with a limit on the line length."""

import bz2
import gzip
import io
import lzma
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any, cast

from knowarm.errors import UserError
from knowarm.reading import one_line

OPENERS: dict[str, Callable[..., Any]] = {
    ".gz": gzip.open,
    ".bz2": bz2.open,
    ".xz": lzma.open,
}
"""Function that opens a compressed file, by suffix."""

MAX_LINE = 1 << 20
"""Longest line in bytes; a file with a longer one is not line-based."""

MAX_RATIO, MAX_SMALL = 250, 64 * 2**20
"""A compressed file of text may hold `MAX_SMALL` bytes, and beyond that at most `MAX_RATIO` times
its own size: more is no graph, but a file made to fill memory or time."""

READ_ERRORS = (
    EOFError,
    OSError,
    ValueError,
    RuntimeError,  # encrypted members of a zip file
    NotImplementedError,  # its unknown methods of compression
    lzma.LZMAError,
    zlib.error,
    zipfile.BadZipFile,
    zipfile.LargeZipFile,
)
"""Errors of reading a file that is incomplete or not compressed as its suffix says."""


def open_bytes(path: Path) -> IO[bytes]:
    """Open a file for reading bytes, decompressing .gz, .bz2, .xz and .zip (with one member).

    Reading raises a `UserError` where a compressed file expands beyond `MAX_RATIO`.
    """
    file = _open(path)
    if path.suffix.lower() not in (".zip", *OPENERS):
        return file
    most = max(MAX_SMALL, MAX_RATIO * path.stat().st_size)
    return cast(IO[bytes], io.BufferedReader(_Limited(file, path, most), 1 << 16))


class _Limited(io.RawIOBase):
    """Reads at most ``most`` bytes of a decompressed file."""

    def __init__(self, file: IO[bytes], path: Path, most: int) -> None:
        self._file, self._path, self._most, self._left = file, path, most, most

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        data = self._file.read(len(buffer))
        self._left -= len(data)
        if self._left < 0:
            raise UserError(
                f"{self._path}: holds more than {self._most:,} bytes, {MAX_RATIO} times its "
                f"compressed size, which no graph or table of words does. If it is from a source "
                f"that you trust, decompress it first."
            )
        buffer[: len(data)] = data
        return len(data)

    def close(self) -> None:
        self._file.close()
        super().close()


def _open(path: Path) -> IO[bytes]:
    suffix = path.suffix.lower()
    if suffix == ".zip":
        archive = zipfile.ZipFile(path)
        if len(names := archive.namelist()) != 1:
            raise UserError(
                f"{path} must contain one file, but contains {', '.join(names[:6]) or 'none'}. "
                f"Unpack it and give the path of the file."
            )
        return archive.open(names[0])
    return cast(IO[bytes], OPENERS.get(suffix, open)(path, "rb"))


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
    except UserError:
        raise
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
        f"{path}: the file cannot be read or decompressed: {one_line(error)}. Copy or compress it "
        f"again."
    )
