"""Parts of your own modules, given as ``package.module:Name``: tasks, algorithms, policies."""

import os
import sys
from collections.abc import Callable
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from knowarm.errors import UserError


@cache
def installed(group: str) -> dict[str, str]:
    """Return the import paths of entry points of installed packages in a group, by name."""
    return {point.name: point.value for point in entry_points(group=group)}


def named_by(variable: str) -> list[str]:
    """Return the import paths in an environment variable, separated by commas."""
    return list(filter(None, os.environ.get(variable, "").split(",")))


def share(variable: str, import_path: str) -> None:
    """Add an import path to an environment variable, last, for processes that this one starts."""
    others = [path for path in named_by(variable) if path != import_path]
    os.environ[variable] = ",".join([*others, import_path])


def load(import_path: str, what: str, fits: Callable[[Any], bool], needed: str) -> Any:
    """Import a task, an algorithm or a policy, as ``what`` says.

    Raises:
        UserError: it is not of that form, cannot be imported, or is not what is ``needed``.
    """
    module, _, name = import_path.partition(":")
    if not module or module.startswith(".") or not name:
        raise UserError(
            f"Your own {what} is given as package.module:Name, got {import_path!r}."
        )
    folder = str(Path.cwd())
    if folder not in sys.path:  # the program's own start leaves it out
        sys.path.append(folder)
    try:
        value = getattr(import_module(module), name, None)
    except ImportError as error:
        raise UserError(
            f"Cannot import the {what} {import_path!r}: {error}. Give package.module:Name, and run "
            "from a folder that contains the package, or install it."
        ) from error
    if not fits(value):
        has = "no" if value is None else "another"
        raise UserError(
            f"{import_path!r} is no {what}: {module} has {has} {name!r}. Name {needed}."
        )
    return value
