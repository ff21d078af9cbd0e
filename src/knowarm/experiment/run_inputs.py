"""Files of the user that the configuration of a run names: graphs, robots and objects."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from knowarm.errors import UserError
from knowarm.knowledge.formats import SHIPPED
from knowarm.reading import digest, read_bytes, writing
from knowarm.world.description import SUFFIX, description_files, trust

Source = Path | bytes
"""A file, or the content of one."""
GRAPHS = ("graph", "edited")
"""Fields that name a graph: a path, or a shipped one."""


def with_inputs(values: Any, renamed: Callable[[str], str], field: str = "") -> Any:
    """Replace the paths of the user's files in JSON values; shipped ones stay."""
    if isinstance(values, dict):
        return {key: with_inputs(value, renamed, key) for key, value in values.items()}
    if isinstance(values, list | tuple):
        return [with_inputs(value, renamed, field) for value in values]
    if not isinstance(values, str):
        return values
    is_graph = field in GRAPHS and values not in SHIPPED
    if is_graph or values.endswith(SUFFIX):
        return renamed(values)
    return values


def input_files(name: str) -> dict[str, Source]:
    """Return a graph, or a description and all that it needs, as files of a folder to copy to."""
    path = Path(name)
    if name.endswith(SUFFIX):
        return description_files(path)
    files: dict[str, Source] = {}
    for file in filter(Path.is_file, [path, *sorted(path.rglob("*"))]):
        name_in_folder = str(file.relative_to(path.parent))
        files[name_in_folder] = file
    return files


def copy_input(name: str, copy: Path) -> None:
    """Copy a graph or description to ``copy``, and what it needs beside it, all or nothing.

    A copy that exists stays; that of a description is trusted as the original is.

    Raises:
        UserError: the copy would need a file elsewhere, or cannot be written.
    """
    if copy.exists() or not Path(name).exists():
        return
    temporary = copy.parent.with_name(f".{copy.parent.name}.tmp").absolute()
    with writing(copy):
        for folder in (temporary, copy.parent):  # what a killed process left
            shutil.rmtree(folder, ignore_errors=True)
        for file, source in input_files(name).items():
            target = temporary / file
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(content_of(source))
        for source in input_files(str(temporary / copy.name)).values():
            if isinstance(source, Path) and not source.is_relative_to(temporary):
                raise UserError(
                    f"{name}: its model names {source} by an absolute path. Name it relative to "
                    "the MJCF file, so that the run can keep a copy."
                )
        temporary.rename(copy.parent)
    trust(str(copy))


def is_copy_of(copy: Path, name: str) -> bool:
    """Tell whether each file of a copy equals that of the original, which may have others, too."""
    originals = input_files(name)
    for file in filter(Path.is_file, copy.parent.rglob("*")):
        original = originals.get(str(file.relative_to(copy.parent)))
        if original is None:
            return False
        if content_of(original) != read_bytes(file):
            return False
    return True


def content_of(source: Source) -> bytes:
    """Return the bytes of a file of `input_files`."""
    if isinstance(source, bytes):
        return source
    return read_bytes(source)


def input_content(name: str) -> str:
    """Return the name of a graph or description with a digest of the content, wherever it is."""
    lines = []
    for file, source in sorted(input_files(name).items()):
        lines.append(f"{file} {digest(content_of(source))}\n")
    whole = digest("".join(lines).encode())
    return f"{Path(name).name} ({whole[:16]})"
