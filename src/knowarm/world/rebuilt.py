"""Copying and pickling of what holds threads or C++ objects."""

from typing import Any, Self


class Rebuilt:
    """Base of what is copied and pickled by its arguments and state, and constructed again.

    A class with a state has ``get_state`` and ``set_state``.
    """

    _arguments: tuple[tuple[Any, ...], dict[str, Any]]

    def __new__(cls, *args: Any, **options: Any) -> Self:
        """Keep the arguments."""
        new = super().__new__(cls)
        new._arguments = (args, options)
        return new

    def __reduce__(self) -> tuple[Any, ...]:
        return _construct, (type(self), *self._arguments), self.get_state()

    def __setstate__(self, state: Any) -> None:
        self.set_state(state)

    def get_state(self) -> Any:
        """Copy the state; None without one."""

    def set_state(self, state: Any) -> None:
        """Restore a state of ``get_state``."""


def _construct(
    cls: type[Rebuilt], args: tuple[Any, ...], options: dict[str, Any]
) -> Rebuilt:
    return cls(*args, **options)
