"""Opening of files for reading: compression, byte order marks, lines."""

import bz2
import gzip
import io
import json
import lzma
import shlex
import zipfile
from codecs import BOM_UTF8, BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Callable, Iterator
from importlib import metadata
from pathlib import Path
from typing import IO, Any

from knowarm.errors import UserError
from knowarm.reading import reading

OPENERS: dict[str, Callable[[Path], Any]] = {
    ".gz": gzip.open,
    ".bz2": bz2.open,
    ".xz": lzma.open,
}
"""Function that opens a compressed file, by suffix."""
COMPRESSED = (*OPENERS, ".zip")
MAX_LINE = 1 << 20
"""Longest line in bytes; a file with a longer one is not line-based."""


_BEGINNING = 1 << 16
"""Bytes by which content is recognized."""
_LIBRARIES = {
    "pandas": "pandas",
    "rdflib": "rdflib",
    "yaml": "pyyaml",
    "read_excel": "openpyxl",
    "nx_pydot": "pydot",
}
"""Libraries that KnowArm does not depend on, by the word in the code that needs them."""


def open_compressed(path: Path) -> IO[bytes]:
    """Open a file for reading bytes, decompressing .gz, .bz2, .xz and .zip (with one member)."""
    suffix = path.suffix.lower()
    if suffix == ".zip":
        archive = zipfile.ZipFile(path)
        names = archive.namelist()
        if len(names) != 1:
            raise UserError(
                f"{path} must contain one file, but contains {', '.join(names[:6]) or 'none'}. "
                f"Unpack it and give the path of the file."
            )
        return archive.open(names[0])
    if suffix in OPENERS:
        return OPENERS[suffix](path)
    return path.open("rb")


def open_bytes(path: Path) -> IO[bytes]:
    """Open as `open_compressed`; after a byte order mark, which is left out, UTF-16 is UTF-8."""
    file = open_compressed(path)
    mark = file.read(len(BOM_UTF8))
    if mark.startswith((BOM_UTF16_LE, BOM_UTF16_BE)):
        with file:
            return io.BytesIO((mark + file.read()).decode("utf-16").encode())
    if mark != BOM_UTF8:
        file.seek(0)
    return file


def suffix_of(path: Path) -> str:
    """Return the suffix of a file in lower case, also of a compressed one."""
    suffix = path.suffix.lower()
    if suffix in COMPRESSED:
        return Path(path.stem).suffix.lower()
    return suffix


def beginning_of(path: Path) -> str:
    """Return the text by which content is recognized."""
    with reading(path, "Copy or compress it again."), open_bytes(path) as file:
        return file.read(_BEGINNING).decode(errors="replace")


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
    for number, line in byte_lines(path):
        yield number, decode(line, path, number)


def to_utf8(path: Path) -> str:
    """Return the command that converts a file of Western Europe."""
    converted = path.with_stem(f"{path.stem}-utf8")
    return f"iconv -f latin1 -t utf-8 {quoted(path)} > {quoted(converted)}"


def quoted(path: Path) -> str:
    """Return a path as a command line holds it."""
    return shlex.quote(str(path))


def python(code: str, file: object, made: object = "") -> str:
    """Return the command that runs Python code on <file>, which writes <made>.

    Libraries that the code needs and this environment lacks are installed first.
    """
    lacking = [
        library
        for word, library in _LIBRARIES.items()
        if word in code and not _is_installed(library)
    ]
    for mark, path in {"<file>": file, "<made>": made}.items():
        code = code.replace(mark, json.dumps(str(path), ensure_ascii=False))
    command = f"python -c {shlex.quote(code)}"
    if lacking:
        return f"pip install {' '.join(lacking)} && {command}"
    return command


def _is_installed(library: str) -> bool:
    """Return whether this environment holds a distribution."""
    try:
        metadata.distribution(library)
    except metadata.PackageNotFoundError:
        return False
    return True


def decode(line: bytes, path: Path, number: int) -> str:
    """Decode one line."""
    try:
        text = line.decode()
    except UnicodeDecodeError as error:
        raise UserError(
            f"{path}, line {number}: not UTF-8 ({error.reason} at byte {error.start}). "
            f"Convert the file: {to_utf8(path)}"
        ) from error
    if "\0" in text:
        raise zero_byte(path, number)
    return text


def zero_byte(path: Path, line: int) -> UserError:
    """Return the error for a line with a zero byte."""
    return UserError(
        f"{path}, line {line}: contains a zero byte, so this is not a text file. "
        f"Check the path and the format."
    )
