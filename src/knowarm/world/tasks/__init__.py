"""Tasks: what is drawn for an episode, how actions move the arm, and how the result is judged.

A task has two parts that are combined freely: what is asked (the folder ``asked``) and what has to
be done (the folder ``skills``). Its name has those of both, as "choose-lift", without what is the
default. Files never name a module: a stored config holds the ``kind`` of each part.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain, product
from typing import TYPE_CHECKING, Any

from knowarm.errors import UserError, unknown_name
from knowarm.own import load, share
from knowarm.world.tasks.asked import ASKED
from knowarm.world.tasks.registry import (
    DEFAULT_ASKED,
    DEFAULT_SKILL,
    VARIABLE,
    task_name,
)
from knowarm.world.tasks.skills import SKILLS

if TYPE_CHECKING:  # Importing this package imports no simulator.
    from knowarm.measures import Measure
    from knowarm.world.tasks.asked.asked import Asking
    from knowarm.world.tasks.probe import BaseProbe, ReportTable
    from knowarm.world.tasks.skills.skill import Skill
    from knowarm.world.tasks.task import Task

TASKS = (
    "reach",
    "lift",
    "place",
    "choose",
    "purpose",
    "families",
    "choose-lift",
    "choose-place",
    "choose-sort",
)
"""Shipped tasks with Gymnasium ids and listed experiments; `find_task` finds every combination."""

DEFAULT_TASK = DEFAULT_SKILL
"""Task unless another one is given; names of experiments leave it out."""


def task_names() -> list[str]:
    """List the names of the listed tasks and of those with a part of another package."""
    names = [*ASKED.kinds(), *SKILLS.kinds()]
    names.remove(DEFAULT_ASKED)
    return list(dict.fromkeys([*TASKS, *names]))


def combinations() -> dict[str, tuple[str, str]]:
    """Return the kinds of what is asked and of the skill by the name of their combination."""
    pairs = product(ASKED.kinds(), SKILLS.kinds())
    return {task_name(*kinds): kinds for kinds in pairs}


def find_task(
    task: "Task | Asking | Skill | str", base: "Task | None" = None
) -> "Task":
    """Return a task.

    Args:
        task: a task, or its name; a part of one, or ``package.module:Name`` of a part or task.
        base: has the other part; None for the defaults.
    """
    from knowarm.world.tasks.asked.asked import Asking
    from knowarm.world.tasks.skills.skill import Skill
    from knowarm.world.tasks.task import Task

    if isinstance(task, str):
        part = _named(task)
    elif isinstance(task, Task | Asking | Skill):
        part = task
    else:
        raise UserError(
            f"task must be a task, such as Task(), or its name, got {task!r}."
        )
    if isinstance(part, Asking):
        return replace(base or Task(), asked=part)
    if isinstance(part, Skill):
        return replace(base or Task(), skill=part)
    return part


def _named(name: str) -> "Task | Asking | Skill":
    """Return the task of a name, or what ``package.module:Name`` is, with its default fields."""
    from knowarm.world.tasks.task import Task

    if ":" in name:
        part = register_task(name)
        if isinstance(part, type):
            return part()
        return part
    kinds = combinations()
    if name not in kinds:
        raise unknown_name("task", name, kinds)
    asked, skill = kinds[name]
    return Task(asked=ASKED.type_of(asked)(), skill=SKILLS.type_of(skill)())


def register_task(import_path: str) -> Any:
    """Add a skill, something to ask, or both of your own module, here and in child processes.

    Args:
        import_path: where its class is, as ``package.module:Name``; a task is an instance.

    Returns:
        What is there.

    Raises:
        UserError: it cannot be imported, is none of these, or has the kind of another one.
    """
    from knowarm.world.tasks.asked.asked import Asking
    from knowarm.world.tasks.skills.skill import Skill
    from knowarm.world.tasks.task import Task

    def is_part(value: Any) -> bool:
        if isinstance(value, type):
            return issubclass(value, Asking | Skill)
        return isinstance(value, Task)

    part = load(
        import_path, "task", is_part, "a class derived from Skill or Asking, or a Task"
    )
    for registry in (ASKED, SKILLS):
        registry.add(import_path)
    for kind in {*ASKED.kinds()} & {*SKILLS.kinds()}:
        raise UserError(
            f"Something to ask and a skill have the kind {kind!r}, so that no task can be named "
            "after it. Give the field ``kind`` of one of them another literal."
        )
    share(VARIABLE, import_path)
    return part


def task_probes() -> "list[type[BaseProbe]]":
    """List the probes that the parts of tasks bring."""
    return list(dict.fromkeys(_brought("probes")))  # subclasses share theirs


def task_measures() -> "list[Measure]":
    """List the measures of all parts of tasks and of their probes."""
    measures = _brought("measures")
    for probe in task_probes():
        measures += probe.measures
    return measures


def report_tables() -> "list[ReportTable]":
    """List the report's tables of all parts of tasks and of their probes."""
    tables = list(dict.fromkeys(_brought("tables")))
    return tables + [probe.table for probe in task_probes() if probe.table is not None]


def _brought(name: str) -> list[Any]:
    """List what all that can be asked and all skills have in a class attribute."""
    parts = [*ASKED.types(), *SKILLS.types()]
    return list(chain.from_iterable(getattr(part, name) for part in parts))


def split_name(text: str) -> Iterator[tuple[str, str]]:
    """Yield the tasks that a text can begin with, the longest first, and the rest after "-"."""
    for name in sorted(combinations(), key=len, reverse=True):
        rest = text.removeprefix(f"{name}-")
        if rest not in (text, ""):
            yield name, rest
