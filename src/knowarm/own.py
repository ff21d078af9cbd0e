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
    """Return the places of the entry points of installed packages in a group, by name."""
    return {point.name: point.value for point in entry_points(group=group)}


def named_by(variable: str) -> list[str]:
    """Return the places that an environment variable names, separated by commas."""
    return [place for place in os.environ.get(variable, "").split(",") if place]


def share(variable: str, place: str) -> None:
    """Name a place in an environment variable, last, for the processes that this one starts."""
    others = (each for each in named_by(variable) if each != place)
    os.environ[variable] = ",".join([*others, place])


def load(place: str, what: str, fits: Callable[[Any], bool], needed: str) -> Any:
    """Import a task, an algorithm or a policy, as ``what`` says.

    Raises:
        UserError: it is no place, cannot be imported, or is not what is ``needed``.
    """
    module, _, name = place.partition(":")
    if not module or module.startswith(".") or not name:
        raise UserError(f"Your own {what} is given as package.module:Name, got {place!r}.")
    if str(Path.cwd()) not in sys.path:  # the program's own start leaves it out
        sys.path.append(str(Path.cwd()))
    try:
        found = getattr(import_module(module), name, None)
    except ImportError as error:
        raise UserError(
            f"Cannot import the {what} {place!r}: {error}. Give package.module:Name, and run from "
            "a folder that contains the package, or install it."
        ) from error
    if not fits(found):
        has = "no" if found is None else "another"
        raise UserError(f"{place!r} is no {what}: {module} has {has} {name!r}. Name {needed}.")
    return found
