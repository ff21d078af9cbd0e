"""Description files: TOML files of the fields of a robot or a target, beside their MJCF file."""

import importlib.util
import json
import os
import re
from codecs import BOM_UTF8
from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from knowarm.config import from_dict
from knowarm.errors import UserError, shell_command
from knowarm.fence import fenced
from knowarm.reading import (
    digest,
    read_bytes,
    read_json,
    read_text,
    read_toml,
    reading,
    write_json,
)
from knowarm.world.cache import cache_file

SUFFIX = ".toml"  # A name with this suffix is the path of a description
# ``mjcf = "menagerie:folder/file.xml"`` names a file of the Menagerie
MENAGERIE = "menagerie:"
HOW_TO_GET = (
    "git clone --depth 1 https://github.com/google-deepmind/mujoco_menagerie, then set "
    "KNOWARM_MENAGERIE to its folder"
)

MAKERS: list[str] = []
"""What makes targets that have no file, as ``package.module:name``: functions of a name that return
a target, or None for a name of others. Parts of tasks add theirs."""

T = TypeVar("T")


def trust(values: Any) -> None:
    """Remember on this machine that the user named the descriptions in JSON values, as they are.

    What is remembered is a digest of every file that belongs to a description.
    """
    for name in _descriptions(values):
        # A TOML file of another kind, one that cannot be used, or a cache that cannot be written
        with suppress(UserError):
            files = [Path(name).absolute(), *_model_files(Path(name))]
            digests = {str(file): _digest(file) for file in files}
            if all(digests.values()):
                write_json(_mark(name), digests)


def check_trusted(values: Any, where: Path) -> None:
    """Refuse JSON values of a file ``where`` that name a description that the user has not named.

    MuJoCo compiles the MJCF of a description, which names files at any path.
    """
    for name in _descriptions(values):
        reason = distrust(name)
        if reason:
            raise UserError(
                f"{where} names the description {name!r}, which is trusted like code, and "
                f"{reason}. If you trust it, name it in a command, and repeat: "
                f"{shell_command('doctor', '--robot', name)}"
            )


def distrust(name: str) -> str:
    """Say why a description is not trusted on this machine, if so; none of its files is parsed."""
    files = {}
    with suppress(UserError):  # no mark, or a damaged one
        files = read_json(_mark(name))
    if not files:
        return "you have not used it on this machine"
    for file, content in files.items():
        if _digest(Path(file)) != content:
            return f"{file} has changed since you used it on this machine"
    return ""


def _digest(file: Path) -> str:
    """Return the digest of a file's content; of one that cannot be read, nothing."""
    with suppress(OSError, UserError):
        state = file.stat()
        # The time of the last change of a file's state cannot be set back.
        known = (state.st_ino, state.st_size, state.st_mtime_ns, state.st_ctime_ns)
        return _digest_of_state(file, known)
    return ""


@cache
def _digest_of_state(file: Path, state: tuple[int, ...]) -> str:
    return digest(read_bytes(file, remedy="Restore the file."))


def _descriptions(values: Any) -> Iterator[str]:
    """Yield the descriptions that JSON values name."""
    if isinstance(values, dict):
        values = list(values.values())
    if isinstance(values, list | tuple):
        for value in values:
            yield from _descriptions(value)
    elif isinstance(values, str) and values.endswith(SUFFIX):
        yield values


def _mark(name: str) -> Path:
    # Of the name: a model lies beside it, and not beside what a link leads to.
    return cache_file("trusted", str(_normal(Path(name)))).with_suffix(".json")


def read_description(path: Path, kind: type[T]) -> T:
    """Read a dataclass with the fields ``name``, by default the file's, and ``mjcf``.

    ``mjcf`` is relative to the file. ``"package:path/in/it.xml"`` names a file of an installed
    Python package, and ``"menagerie:folder/file.xml"`` one of a MuJoCo Menagerie checkout.
    """
    values = {"name": path.stem, **read_toml(path)}
    values["mjcf"] = _mjcf(values, path)
    return from_dict(kind, values, where=str(path))


def description_files(path: Path) -> dict[str, Path | bytes]:
    """Return a description, its MJCF files and their meshes and textures, as files of a folder.

    The model's files keep their places relative to each other, below ``model``.
    """
    mjcf = _normal(_mjcf(read_toml(path), path))
    files = _model_files(path)
    root = os.path.commonpath([file.parent for file in files])
    places = {file: f"model/{file.relative_to(root).as_posix()}" for file in files}
    text = read_text(path, remedy="Correct the file.")
    line = f"mjcf = {json.dumps(places[mjcf])}".replace("\\", "\\\\")
    text = re.sub(r"""(?m)^\s*["']?mjcf["']?\s*=.*$""", line, text, count=1)
    model_files = dict(zip(places.values(), files, strict=True))
    return {path.name: text.encode(), **model_files}


def _model_files(path: Path) -> list[Path]:
    """Return the MJCF files of a description, with all meshes and textures that they name."""
    mjcf = _normal(_mjcf(read_toml(path), path))
    with reading(mjcf, f"{str(path)!r} names it: correct it there, or in the model."):
        return fenced(_files_of, mjcf)


def _files_of(mjcf: Path) -> list[Path]:
    """Return an MJCF file and the files that it names.

    MuJoCo lists height fields outside the folder of meshes, and the others in the first of several
    such folders, where it opens those in the last: these files are added.
    """
    import mujoco  # most who read descriptions need no simulator

    listed = [_normal(Path(name)) for name in mujoco.mju_getXMLDependencies(str(mjcf))]
    opened = {}
    for model in filter(_is_xml, listed):
        with suppress(ValueError):  # a part, which another one includes
            spec = mujoco.MjSpec.from_file(str(model))
            for part in (*spec.meshes, *spec.hfields, *spec.skins, *spec.textures):
                for folder in (spec.meshdir, spec.texturedir):
                    file = _normal(model.parent / folder / part.file)
                    if file.is_file():
                        opened[file] = file.name
    names = set(opened.values())
    listed = [file for file in listed if file.is_file() or file.name not in names]
    return list(dict.fromkeys([*listed, *opened]))


def _is_xml(file: Path) -> bool:
    """Return whether a file may be a model, and not a mesh or texture."""
    data = read_bytes(file) if file.is_file() else b""
    return data.removeprefix(BOM_UTF8).lstrip().startswith(b"<")


def _normal(path: Path) -> Path:
    """Return an absolute path without "..", whose links are not followed."""
    return Path(os.path.normpath(path.absolute()))


def menagerie_folder() -> Path:
    """Return the folder in which the Menagerie is searched: ``KNOWARM_MENAGERIE``, or a cache."""
    folder = os.environ.get("KNOWARM_MENAGERIE")
    if folder:
        return Path(folder)
    cache = os.environ.get("ROBOT_DESCRIPTIONS_CACHE")
    if cache:
        return Path(cache) / "mujoco_menagerie"
    return Path.home() / ".cache" / "robot_descriptions" / "mujoco_menagerie"


def _mjcf(values: Mapping[str, Any], path: Path) -> Path:
    """Return the path of the MJCF file of a description: as in ``read_description``."""
    mjcf = values.get("mjcf")
    if not isinstance(mjcf, str):
        raise UserError(
            f"{str(path)!r}: field mjcf must be the path of an MJCF file, got {mjcf!r}."
        )
    if mjcf.startswith(MENAGERIE):
        return menagerie_folder() / mjcf.removeprefix(MENAGERIE)
    package, colon, inside = mjcf.partition(":")
    is_drive = len(package) == 1
    if not colon or is_drive or not package.isidentifier():
        return path.parent / mjcf
    try:
        spec = importlib.util.find_spec(package)
    except (ImportError, ValueError):
        spec = None
    if spec is None or not spec.submodule_search_locations:
        raise UserError(
            f"{str(path)!r}: mjcf is {mjcf!r}, and the Python package {package!r} is not "
            "installed. Install it, or give the path of a file."
        )
    return Path(spec.submodule_search_locations[0]) / inside
