"""Description files: TOML files of a user's own robots and targets."""

import importlib.util
import tomllib
from pathlib import Path
from typing import Any, TypeVar

from knowarm.config import from_dict
from knowarm.errors import UserError
from knowarm.reading import one_line, read_text
from knowarm.world.objects.target import Target
from knowarm.world.robots.menagerie import SCHEME, menagerie_file
from knowarm.world.robots.robot import Robot

T = TypeVar("T", Robot, Target)

SUFFIX = ".toml"  # A name with this suffix is the path of a description file


def read_robot(path: Path) -> Robot:
    """Read a robot: the fields of ``Robot``, with ``mjcf`` relative to the file.

    ``mjcf = "package:path/in/it.xml"`` names a file of an installed Python package, and
    ``"menagerie:folder/file.xml"`` one of a MuJoCo Menagerie checkout.
    """
    return _read(path, Robot)


def read_target(path: Path) -> Target:
    """Read a target: the fields of ``Target``; otherwise as ``read_robot``."""
    return _read(path, Target)


def _read(path: Path, kind: type[T]) -> T:
    text = read_text(path, remedy="Give the path of a TOML file.", most=2**20)
    try:
        values = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise UserError(f"{str(path)!r} is not TOML: {one_line(error)}.") from None
    if not isinstance(values.get("mjcf"), str):
        raise UserError(
            f"{str(path)!r}: field mjcf must be the path of an MJCF file, got "
            f"{values.get('mjcf')!r}."
        )
    known: dict[str, Any] = {"name": path.stem} | values
    known["mjcf"] = _resolve(values["mjcf"], path)
    return from_dict(kind, known, where=str(path))


def _resolve(mjcf: str, path: Path) -> Path:
    """Resolve ``mjcf``: in a package if it names one, else relative to the TOML file."""
    package, colon, inside = mjcf.partition(":")
    if package == SCHEME:
        return menagerie_file(inside, f"Robot {path.stem!r}")
    if not colon or not package.isidentifier():
        return path.parent / mjcf
    try:
        found = importlib.util.find_spec(package)
    except (ImportError, ValueError):
        found = None
    if found is None or not found.submodule_search_locations:
        raise UserError(
            f"{str(path)!r}: mjcf is {mjcf!r}, and the Python package {package!r} is not "
            "installed. Install it, or give the path of a file."
        )
    return Path(found.submodule_search_locations[0]) / inside
