"""User errors: mistakes in arguments, configs and files that a user can fix."""

import shlex
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any
from warnings import warn as _warn


@dataclass(frozen=True)
class Argument:
    """An argument with a value, in an error: ``resume=True``; on the command line ``--resume``."""

    name: str
    """Its name, after that of the part of an experiment's config that has it: knows.detail."""
    value: Any

    def __str__(self) -> str:
        return f"{self.name.rpartition('.')[2]}={self.value!r}"


class UserError(ValueError):
    """A mistake that the user can fix.

    The message is one line, in one or several parts: what was wrong, the given value, the allowed
    values, the remedy. It names arguments, not options: where one is to be set, an `Argument` is
    a part. The command line prints it without a traceback and exits with code 2.
    """

    def __init__(self, *parts: str | Argument) -> None:
        super().__init__(*parts)

    def __str__(self) -> str:
        return "".join(map(str, self.args))


@contextmanager
def packages_of(extra: str, what: str) -> Iterator[None]:
    """Turn the failed import of a package of an extra into a `UserError`: what needs it."""
    try:
        yield
    except ImportError as error:
        raise UserError(
            f"{what} needs a package that is not installed ({error.name}): "
            f"pip install 'knowarm[{extra}]'."
        ) from error


class DataWarning(UserWarning):
    """What was left out of a user's file, or may be meant otherwise, in one line."""


def warn(message: str) -> None:
    """Warn of something in a user's file."""
    _warn(message, DataWarning, stacklevel=3)


def printable(text: str) -> str:
    """Escape the characters of a text from a file that a terminal would act upon."""
    return "".join(
        c if c.isprintable() else c.encode("unicode_escape").decode() for c in text
    )


def shell_command(*words: object) -> str:
    """Return a command of KnowArm as a shell reads it: words with spaces are quoted."""
    return shlex.join(["knowarm", *map(str, words)])


def unknown_name(kind: str, given: str, allowed: Iterable[str]) -> UserError:
    """Build the error for a name that is not among the allowed ones, nearest names first.

    Args:
        kind: what the name stands for ("robot", "experiment", ...).
        given: the name that was not found.
        allowed: all valid names.

    Returns:
        The error; the caller raises it.
    """
    names = sorted(allowed)
    near: list[str] = []
    if given:
        near += [name for name in names if name == f"{given}s"]
        near += [name for name in names if name.startswith(f"{given}_")]
    if not near:
        near = get_close_matches(given, names, n=3, cutoff=0.5)
    hint = f" Did you mean {', '.join(map(repr, near[:3]))}?" if near else ""
    available = ", ".join(names[:24]) or "none"
    if len(names) > 24:
        available += f", ... ({len(names)})"
    return UserError(f"Unknown {kind} {given!r}.{hint} Available: {available}.")
