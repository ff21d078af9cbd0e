"""Line reader for large text files, plain or compressed, with a limit on the line length."""

import bz2
import gzip
import lzma
from collections.abc import Iterator
from pathlib import Path
from typing import IO, cast

from knowarm.errors import UserError

BLOCK = 1 << 22
"""Bytes read at once."""

MAX_LINE = 1 << 20
"""Longest line in bytes; a file with a longer one is not line-based."""


def open_bytes(path: Path) -> IO[bytes]:
    """Open a file for reading bytes, decompressing .gz, .bz2 and .xz."""
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
    """Yield (number of the first line, lines without their ends), a few megabytes at a time.

    Args:
        file: the open file.
        path: its path, for messages.
        max_line: longest line in bytes. A longer one is refused after one block, so that a file
            of many gigabytes without a line end takes no memory.

    Raises:
        UserError: a line is too long, or the file cannot be decompressed.
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
                    f"{path}, line {number}: the line is longer than {max_line:,} bytes, so the "
                    f"file does not hold one record per line. Check the format and the line ends."
                )
    except (EOFError, OSError, lzma.LZMAError) as error:
        raise UserError(
            f"{path}, near line {number}: the file cannot be decompressed: {error}. "
            f"Copy or compress it again."
        ) from error
    if rest:
        yield number, [rest]


def text_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield (line number, text) of every line of a UTF-8 file.

    Raises:
        UserError: a line is too long or is not UTF-8.
    """
    with open_bytes(path) as file:
        for first, lines in line_blocks(file, path):
            for number, line in enumerate(lines, first):
                yield number, decode(line, path, number)


def decode(line: bytes, path: Path, number: int) -> str:
    """Decode one line, without its carriage return.

    Raises:
        UserError: it is not UTF-8, or contains a zero byte.
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
            f"{path}, line {number}: contains a zero byte, so this is not a text file. "
            f"Check the path and the format."
        )
    return text.removeprefix("\ufeff") if number == 1 else text
