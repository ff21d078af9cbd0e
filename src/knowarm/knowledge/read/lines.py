"""A text file, plain or packed, goes in; numbered lines come out, none longer than a limit."""

import bz2
import gzip
import lzma
from collections.abc import Iterator
from pathlib import Path
from typing import IO, cast

from knowarm.errors import UserError

BLOCK = 1 << 22
MAX_LINE = 1 << 20
"""Longest line in bytes; a longer one means that the file is no line-based format."""


def open_bytes(path: Path) -> IO[bytes]:
    """Open a file for reading bytes, unpacking .gz, .bz2 and .xz."""
    suffix = path.suffix.lower()
    if suffix == ".gz":
        return cast(IO[bytes], gzip.open(path, "rb"))
    if suffix == ".bz2":
        return cast(IO[bytes], bz2.open(path, "rb"))
    if suffix == ".xz":
        return cast(IO[bytes], lzma.open(path, "rb"))
    return path.open("rb")


def line_blocks(
    file: IO[bytes], path: Path, max_line: int = MAX_LINE
) -> Iterator[tuple[int, list[bytes]]]:
    """Yield (number of the first line, lines without their ends) a few megabytes at a time.

    Raises:
        UserError: a line is longer than `max_line`, which is found after one block: a file of
            many gigabytes without a line end costs no memory.
    """
    number, rest = 1, b""
    try:
        while block := file.read(BLOCK):
            end = block.rfind(b"\n")
            if end >= 0:
                lines = (rest + block[:end]).split(b"\n")
                rest = block[end + 1 :]
                yield number, lines
                number += len(lines)
            else:
                rest += block
            if len(rest) > max_line:
                raise UserError(
                    f"{path}, line {number}: the line is longer than {max_line:,} bytes, so this "
                    f"is no file of one record a line. Check the format and the line ends."
                )
    except (EOFError, OSError, lzma.LZMAError) as error:
        raise UserError(
            f"{path}, near line {number}: the file cannot be unpacked: {error}. "
            f"Fetch or pack it again."
        ) from error
    if rest:
        yield number, [rest]


def numbered_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield (line number, text) of every line that is not blank.

    Raises:
        UserError: a line is too long or is not UTF-8.
    """
    with open_bytes(path) as file:
        for first, lines in line_blocks(file, path):
            for number, line in enumerate(lines, first):
                text = decode(line, path, number)
                if text and not text.isspace():
                    yield number, text


def decode(line: bytes, path: Path, number: int) -> str:
    """Decode one line, without its carriage return.

    Raises:
        UserError: it is not UTF-8, or holds a zero byte.
    """
    try:
        text = line.decode().rstrip("\r")
    except UnicodeDecodeError as error:
        raise UserError(
            f"{path}, line {number}: not UTF-8 ({error.reason} at byte {error.start}). "
            f"Convert the file, e.g. `iconv -f latin1 -t utf-8`."
        ) from error
    if "\0" in text:
        raise UserError(
            f"{path}, line {number}: holds a zero byte, so this is no text file. "
            f"Name the right file."
        )
    return text.removeprefix("\ufeff") if number == 1 else text
