"""Line reader for large text files, plain or compressed, with a limit on the line length."""

import bz2
import gzip
import lzma
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any, cast

from knowarm.errors import UserError
from knowarm.reading import reading

OPENERS: dict[str, Callable[..., Any]] = {".gz": gzip.open, ".bz2": bz2.open, ".xz": lzma.open}
"""Function that opens a compressed file, by suffix."""
MAX_LINE = 1 << 20
"""Longest line in bytes; a file with a longer one is not line-based."""


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
    return cast(IO[bytes], OPENERS.get(suffix, open)(path, "rb"))


def byte_lines(path: Path) -> Iterator[tuple[int, bytes]]:
    """Yield (line number, line without its end) of a file."""
    number = 0
    with reading(path, "Copy or compress it again."), open_bytes(path) as file:
        while line := file.readline(MAX_LINE + 1):
            number += 1
            if len(line) > MAX_LINE:
                raise UserError(
                    f"{path}, line {number}: the line is longer than {MAX_LINE:,} bytes, so "
                    f"the file does not hold one record per line. Check the format."
                )
            yield number, line.rstrip(b"\r\n")


def text_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield (line number, text without its end) of a UTF-8 file."""
    return ((number, decode(line, path, number)) for number, line in byte_lines(path))


def decode(line: bytes, path: Path, number: int) -> str:
    """Decode one line."""
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
