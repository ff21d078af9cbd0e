"""Tasks: what is drawn for an episode, how actions move the arm, and how the result is judged.

A task is a class derived from `knowarm.world.tasks.task.Task` with one entry in ``TASKS``. One of
another package is found by its entry point in the group "knowarm.tasks", by the environment
variable ``KNOWARM_TASKS``, or after `register_task`. Files never name a module: a stored config
holds the task's ``kind``.
"""

from typing import TYPE_CHECKING

from knowarm.errors import UserError, unknown_name
from knowarm.own import installed, load, named_by, share

if TYPE_CHECKING:  # Importing this package imports no simulator.
    from knowarm.world.tasks.task import Task

GROUP = "knowarm.tasks"
"""Group of the entry points of other packages."""

VARIABLE = "KNOWARM_TASKS"
"""Environment variable with further tasks, as ``package.module:Name`` separated by commas."""

TASKS: dict[str, str] = {
    "reach": "knowarm.world.tasks.reach:Reach",
    "lift": "knowarm.world.tasks.lift.lift:Lift",
    "choose": "knowarm.world.tasks.choose.choose:Choose",
    "purpose": "knowarm.world.tasks.choose.purpose:Purpose",
    "families": "knowarm.world.tasks.choose.choose:Families",
}
"""Tasks by their ``kind``, as ``package.module:Name``. To add one, add an entry."""

DEFAULT_TASK = "reach"
"""Task unless another one is given; names of experiments leave it out."""


def task_names() -> list[str]:
    """List the names of all tasks: shipped, installed and registered."""
    for import_path in named_by(VARIABLE):
        if import_path not in TASKS.values():
            register_task(import_path)
    return list(dict.fromkeys([*TASKS, *installed(GROUP)]))


def task_type(name: str) -> "type[Task]":
    """Return the class of a name in ``task_names``, or register ``package.module:Name``."""
    if ":" in name:
        return register_task(name)
    names = task_names()
    if name not in names:
        raise unknown_name("task", name, names)
    return _load((installed(GROUP) | TASKS)[name])


def find_task(task: "Task | str") -> "Task":
    """Return a task, also one that is given by its name or as ``package.module:Name``."""
    from knowarm.world.tasks.task import Task

    found = task_type(task)() if isinstance(task, str) else task
    if not isinstance(found, Task):
        raise UserError(f"task must be a task, such as Reach(), or its name, got {task!r}.")
    return found


def register_task(import_path: str) -> "type[Task]":
    """Add a task of your own module to ``TASKS``, by its ``kind``, here and in child processes.

    Args:
        import_path: where its class is, as ``package.module:Name``.

    Raises:
        UserError: it cannot be imported, is no task, or has the name of another one.
    """
    task = _load(import_path)
    name = task.kind_of()
    other = (installed(GROUP) | TASKS).get(name, import_path)
    if other != import_path:
        raise UserError(
            f"The task {import_path} has the kind {name!r}, which {other} has already; give its "
            "field ``kind`` another literal."
        )
    TASKS[name] = import_path
    share(VARIABLE, import_path)
    return task


def _load(import_path: str) -> "type[Task]":
    """Import a class given as ``package.module:Name``."""
    from knowarm.world.tasks.task import Task

    return load(
        import_path,
        "task",
        lambda found: isinstance(found, type) and issubclass(found, Task),
        "a class derived from knowarm.world.tasks.task.Task",
    )
