"""Reading and writing of stored files: every defect is one kind of error, with its remedy."""

import errno
import hashlib
import json
import os
import secrets
import shutil
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import load

from knowarm.errors import UserError


class UnreadableFileError(UserError):
    """A stored file is missing, incomplete, damaged, or of another format."""


def digest(data: bytes) -> str:
    """Return the SHA-256 of a file's content, hexadecimal."""
    return hashlib.sha256(data).hexdigest()


@contextmanager
def reading(path: Path, remedy: str) -> Iterator[None]:
    """Turn whatever damaged content raises in a ``with`` block into an `UnreadableFileError`.

    The libraries that decode files raise many types of errors, and those written in Rust panics
    that are no `Exception`. Put only the decoding of one file into the block, so that no mistake of
    the program is taken for a damaged file. `remedy` is a sentence.

    A FIFO, socket or device is refused before it is opened: it could let the reader wait for ever.
    """
    try:
        if path.exists() and not path.is_file() and not path.is_dir():
            raise OSError(errno.EINVAL, "it is a FIFO, socket or device, and no file")
        yield
    except UserError:
        raise
    except OSError as error:
        reason = error.strerror or one_line(error)
        raise UnreadableFileError(f"Cannot read {path}: {reason}. {remedy}") from error
    except BaseException as error:
        if (
            not isinstance(error, Exception)
            and type(error).__name__ != "PanicException"
        ):
            raise
        reason = f"is damaged or of another format: {one_line(error)}"
        raise UnreadableFileError(f"{path} {reason}. {remedy}") from error


LFS_POINTER = b"version https://git-lfs.github.com/spec/"
"""Beginning of the text that stands for a file of Git LFS that is not fetched."""

WEB_PAGES = (b"<!doctype html", b"<html")
"""Beginnings of pages about a file, which browsers save in its place."""


def refuse_pointer(path: Path) -> None:
    """Refuse a file that is missing its content: a pointer of Git LFS, or a web page about it."""
    try:
        with reading(path, ""), path.open("rb") as file:
            start = file.read(len(LFS_POINTER))
    except UnreadableFileError:  # who reads the file says so
        return
    if start == LFS_POINTER:
        raise UserError(
            f"{path} is a pointer of Git LFS, and not the file itself. Install git-lfs and fetch "
            f"the files: git -C {path.parent} lfs pull."
        )
    if start.lstrip().lower().startswith(WEB_PAGES):
        raise UserError(
            f"{path} is a web page, and not the file itself. Download the raw file, or clone the "
            "repository."
        )


@contextmanager
def writing(path: Path, remedy: str = "") -> Iterator[None]:
    """Turn an `OSError` while a file is written into a `UserError` with a remedy."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or error
        raise UserError(f"Cannot write {path}: {reason}. {remedy}".rstrip()) from error


@contextmanager
def replacing(path: Path, remedy: str = "") -> Iterator[Path]:
    """Write a file under a random name, renamed at the end, in a folder that is made if missing.

    No link is followed: one at ``path`` is replaced, as a FIFO is, and nobody can prepare one at a
    random name.
    """
    temporary = path.with_name(f".{path.stem}.{secrets.token_hex(8)}{path.suffix}")
    with writing(path, remedy):
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir() or path.absolute().is_relative_to("/dev"):
            yield path  # an error of the system, or a device such as /dev/stdout
            return
        temporary.touch(exist_ok=False)  # O_CREAT | O_EXCL
        try:
            yield temporary
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)


@contextmanager
def new_folder(folder: Path) -> Iterator[Path]:
    """Write a folder under a random name, renamed at the end; nobody sees a part of it."""
    folder = folder.absolute()
    temporary = folder.with_name(f".{folder.name}.{secrets.token_hex(8)}")
    try:
        temporary.mkdir(parents=True)
        yield temporary
        if folder.exists():
            folder.rmdir()  # an empty one
        temporary.rename(folder)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def refuse_links(folder: Path) -> None:
    """Refuse a folder with links that lead out of it: they would name files of the user.

    Links to ``../../blobs`` stay in a folder ``models--*``: there the cache of the Hugging Face Hub
    keeps the files of the same repository.

    Raises:
        UserError: it holds such a link, or a folder that cannot be listed.
    """
    root = Path(os.path.realpath(folder))
    blobs = root.parent.parent / "blobs"
    if not blobs.match("models--*/blobs"):
        blobs = root
    for parent, folders, files in os.walk(folder, onerror=_refuse_unlisted):
        for name in (*folders, *files):
            path = Path(parent, name)
            if not path.is_symlink():
                continue
            target = Path(os.path.realpath(path))
            if not target.is_relative_to(root) and target.parent != blobs:
                raise UserError(
                    f"{path} is a link to {target}, outside of {folder}. Replace it by a copy, if "
                    "you trust where the folder comes from."
                )


def _refuse_unlisted(error: OSError) -> None:
    """Refuse a folder that cannot be listed, unless it is one of a writer and gone again."""
    if not isinstance(error, FileNotFoundError):
        with reading(Path(error.filename), "Change its permissions."):
            raise error


def one_line(error: BaseException) -> str:
    """Return the reason that an exception gives, on one line of at most 300 characters."""
    text = " ".join(str(error).split()).rstrip(".") or type(error).__name__
    if isinstance(error, KeyError):
        text = f"missing {text}"
    if len(text) > 300:
        text = text[:297] + "..."
    return text


def read_bytes(
    path: Path, *, remedy: str = "Restore the file, or give another one."
) -> bytes:
    """Read a file as a whole."""
    with reading(path, remedy):
        return path.read_bytes()


def read_text(path: Path, *, remedy: str) -> str:
    """Read a UTF-8 text file, without its byte order mark."""
    data = read_bytes(path, remedy=remedy)
    with reading(path, remedy):
        return data.decode("utf-8-sig")


def read_json(
    path: Path, *, remedy: str = "Restore the file, or give another one."
) -> dict[str, Any]:
    """Read a JSON object."""
    text = read_text(path, remedy=remedy)
    with reading(path, remedy):
        values = json.loads(text)
        if not isinstance(values, dict):
            raise ValueError(f"it holds a {type(values).__name__}, and no JSON object")
    return values


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file."""
    text = read_text(path, remedy="Give the path of a TOML file.")
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise UserError(f"{str(path)!r} is not TOML: {one_line(error)}.") from None


def read_arrays(path: Path, *, remedy: str) -> dict[str, np.ndarray]:
    """Read the arrays of a safetensors file by name."""
    with reading(path, remedy):
        return load(read_bytes(path, remedy=remedy))


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """Write a JSON object as `write_text` does."""
    write_text(path, json.dumps(values, indent=2) + "\n")


def write_text(path: Path, text: str, remedy: str = "") -> None:
    """Write a text through a temporary file, so that readers never see a part of it."""
    with replacing(path, remedy) as temporary:
        temporary.write_text(text, encoding="utf-8")
