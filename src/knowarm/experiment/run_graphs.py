"""Graphs that the configuration of a run names."""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from knowarm.knowledge.formats import SHIPPED
from knowarm.perception.module import digest

GRAPHS = ("graph", "edited")
"""Fields that name a graph: a path, or a shipped one."""


def with_graphs(values: Any, renamed: Callable[[str], str]) -> Any:
    """Replace the paths of the graphs that a configuration names; shipped graphs stay."""
    if not isinstance(values, dict):
        return values
    return {
        key: renamed(value)
        if key in GRAPHS and isinstance(value, str) and value not in SHIPPED
        else with_graphs(value, renamed)
        for key, value in values.items()
    }


def graph_content(graph: str) -> str:
    """Return the name of a graph's file or folder with a digest of the content, wherever it is."""
    path, whole = Path(graph), hashlib.sha256()
    for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
        if file.is_file():
            whole.update(f"{file.relative_to(path)} {digest(file.read_bytes())}\n".encode())
    return f"{path.name} ({whole.hexdigest()[:16]})"
