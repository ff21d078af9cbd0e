"""Formats of graphs that are not read, by name, with the way to one that is."""

import re
from pathlib import Path
from typing import NamedTuple

from knowarm.errors import UserError
from knowarm.knowledge.formats.files import python, quoted
from knowarm.reading import read_toml


class Other(NamedTuple):
    """A format that is not read, as the file says it."""

    suffixes: tuple[str, ...]
    way: str = ""
    code: str = ""
    made: str = ""
    begins: str = r"(?!)"


_FILE = read_toml(Path(__file__).with_name("others.toml"))
OTHERS = {name: Other(**fields) for name, fields in _FILE.items()}
"""Formats by what they are called."""


def refuse_others(path: Path, suffix: str, content: str) -> None:
    """Refuse a file of one of `OTHERS`, by its suffix or content."""
    for name, other in OTHERS.items():
        is_it = re.match(other.begins, content, re.DOTALL) is not None
        if suffix in other.suffixes or is_it:
            way = _way(path, other)
            raise UserError(f"{path}: {name} is not read. {way}")


def _way(path: Path, other: Other) -> str:
    """Return what to do with a file."""
    if other.code:
        made = f"{path}{other.made}"
        return f"Convert it: {python(other.code, path, made)}"
    name = quoted(path.with_suffix(""))
    return other.way.replace("<file>", quoted(path)).replace("<name>", name)
