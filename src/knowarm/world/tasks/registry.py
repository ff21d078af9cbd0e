"""Registries of what can be asked and of skills: classes by their ``kind``."""

from collections.abc import Iterator
from dataclasses import fields
from typing import Any, get_args, get_type_hints

from knowarm.errors import UserError, unknown_name
from knowarm.own import installed, load, named_by

VARIABLE = "KNOWARM_TASKS"
"""Environment variable with tasks, skills and questions of other modules, as
``package.module:Name`` separated by commas."""

DEFAULT_ASKED = "nothing"
"""What is asked unless something else is given; names of tasks leave it out."""

DEFAULT_SKILL = "reach"
"""Skill unless another one is given; names of tasks with a question leave it out."""


def task_name(asked: str, skill: str) -> str:
    """Return the name of a task from the kinds of its parts."""
    if asked == DEFAULT_ASKED:
        return skill
    if skill == DEFAULT_SKILL:
        return asked
    return f"{asked}-{skill}"


class Registry(dict[str, str]):
    """Classes of configs by ``kind``, as ``package.module:Name``; imported when they are used.

    Args:
        what: what is registered, for errors.
        base: import path of the class that all derive from.
        shipped: the entries of this package.

    Those of other packages are found by their entry point in the group ``knowarm.<what>``, by the
    environment variable ``KNOWARM_TASKS``, or after `knowarm.register_task`.
    """

    def __init__(self, what: str, base: str, shipped: dict[str, str]) -> None:
        super().__init__(shipped)
        self.what = what
        self._base = base

    def kinds(self) -> list[str]:
        """List the kinds of all classes: shipped, installed and registered."""
        for import_path in named_by(VARIABLE):
            if import_path not in self.values():
                self.add(import_path)
        return list(dict.fromkeys([*self, *installed(self._group)]))

    def type_of(self, kind: str) -> Any:
        """Import the class of a kind."""
        kinds = self.kinds()
        if kind not in kinds:
            raise unknown_name(self.what, kind, kinds)
        return self._load((installed(self._group) | self)[kind])

    def types(self) -> list[Any]:
        """Import the classes of all kinds."""
        return [self.type_of(kind) for kind in self.kinds()]

    def add(self, import_path: str) -> None:
        """Add what an import path holds for this registry, if it does.

        Raises:
            UserError: it cannot be imported, or has no kind, or that of another class.
        """
        base = self._load(self._base)
        for cls in _classes(
            load(import_path, "task", lambda part: part is not None, "a task")
        ):
            if not issubclass(cls, base):
                continue
            path = f"{cls.__module__}:{cls.__qualname__}"
            kind = kind_of(cls)
            other = (installed(self._group) | self).get(kind, path)
            if other != path:
                raise UserError(
                    f"The task {path} has the kind {kind!r}, which {other} has already; give its "
                    "field ``kind`` another literal."
                )
            self[kind] = path

    @property
    def _group(self) -> str:
        return f"knowarm.{self.what}"

    def _load(self, import_path: str) -> Any:
        return load(
            import_path, self.what, lambda part: isinstance(part, type), "a class"
        )


def kind_of(cls: type) -> str:
    """Return the tag of a class in JSON and in the names of experiments.

    Raises:
        UserError: the class declares no field ``kind`` with one literal.
    """
    tags = get_args(get_type_hints(cls).get("kind"))
    if len(tags) != 1:
        word = cls.__name__.lower()
        raise UserError(
            f"The task {cls.__qualname__} needs a field that names it: kind: "
            f"Literal['{word}'] = '{word}'."
        )
    return str(tags[0])


def _classes(part: Any) -> Iterator[type]:
    """Yield a class, or the classes of the two fields of a task."""
    if isinstance(part, type):
        yield part
        return
    for field in fields(part):
        yield type(getattr(part, field.name))
