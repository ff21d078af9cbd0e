"""Tasks: what is drawn for an episode, how actions move the arm, and how the result is judged.

A task is a class derived from `knowarm.world.tasks.task.Task` with one entry in ``TASKS``. One of
another package is found by its entry point in the group "knowarm.tasks", by the environment
variable ``KNOWARM_TASKS``, or after `register_task`. Files never name a module: a stored config
holds the task's ``kind``.
"""

import os
import sys
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING

from knowarm.errors import UserError, unknown_name

if TYPE_CHECKING:  # Importing this package imports no simulator.
    from knowarm.world.tasks.task import Task

GROUP = "knowarm.tasks"
"""Group of the entry points of other packages."""

VARIABLE = "KNOWARM_TASKS"
"""Environment variable with further tasks, as ``package.module:Name`` separated by commas."""

TASKS: dict[str, str] = {
    "reach": "knowarm.world.tasks.reach:Reach",
    "lift": "knowarm.world.tasks.lift:Lift",
    "choose": "knowarm.world.tasks.choose.choose:Choose",
    "purpose": "knowarm.world.tasks.choose.purpose:Purpose",
    "families": "knowarm.world.tasks.choose.choose:Families",
}
"""Tasks by their ``kind``, as ``package.module:Name``. To add one, add an entry."""


@cache
def _installed() -> dict[str, str]:
    """Return the tasks of the entry points of installed packages."""
    return {point.name: point.value for point in entry_points(group=GROUP)}


def task_names() -> list[str]:
    """List the names of all tasks: shipped, installed and registered."""
    for place in filter(None, os.environ.get(VARIABLE, "").split(",")):
        if place not in TASKS.values():
            register_task(place)
    return list(dict.fromkeys([*TASKS, *_installed()]))


def task_type(name: str) -> "type[Task]":
    """Return the class of a name in ``task_names``, or register ``package.module:Name``."""
    if ":" in name:
        return register_task(name)
    names = task_names()
    if name not in names:
        raise unknown_name("task", name, names)
    return _load((_installed() | TASKS)[name])


def task_types() -> "list[type[Task]]":
    """Return the classes of all tasks."""
    return [task_type(name) for name in task_names()]


def register_task(place: str) -> "type[Task]":
    """Add a task of your own module to ``TASKS``, by its ``kind``.

    Args:
        place: where its class is, as ``package.module:Name``.

    Raises:
        UserError: it cannot be imported, is no task, or has the name of another one.
    """
    found = _load(place)
    name = found.kind_of()
    other = (_installed() | TASKS).get(name, place)
    if other != place:
        raise UserError(
            f"The task {place} has the kind {name!r}, which {other} has already; give its field "
            "``kind`` another literal."
        )
    TASKS[name] = place
    return found


@cache
def _load(place: str) -> "type[Task]":
    """Import a class given as ``package.module:Name``."""
    from knowarm.world.tasks.task import Task

    module, _, name = place.partition(":")
    if not module or module.startswith(".") or not name:
        raise UserError(f"A task of your own is given as package.module:Name, got {place!r}.")
    if str(Path.cwd()) not in sys.path:  # the program's own start leaves it out
        sys.path.append(str(Path.cwd()))
    try:
        found = getattr(import_module(module), name, None)
    except ImportError as error:
        raise UserError(
            f"Cannot import the task {place!r}: {error}. Give package.module:Name, and run from a "
            "folder that contains the package, or install it."
        ) from error
    if not (isinstance(found, type) and issubclass(found, Task)):
        raise UserError(
            f"{place!r} is no task: {module} has {'no' if found is None else 'another'} {name!r}. "
            "Name a class derived from knowarm.world.tasks.task.Task."
        )
    return found
