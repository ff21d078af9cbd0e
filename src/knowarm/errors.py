"""What a user did wrong goes in; one message that says how to mend it comes out."""

from collections.abc import Iterable
from difflib import get_close_matches


class UserError(ValueError):
    """A mistake the user can mend.

    The message is one line: what was wrong, what was given, what is allowed, what to do.
    The command line prints it without a traceback and exits with code 2.
    """


def unknown_name(kind: str, given: str, allowed: Iterable[str]) -> UserError:
    """Build the error for a name that is not among the allowed ones, nearest names first.

    Args:
        kind: what the name stands for, as the user knows it ("robot", "experiment", ...).
        given: the name that was not found.
        allowed: every name that would have been accepted.

    Returns:
        The error, to be raised by the caller.
    """
    names = sorted(allowed)
    near = get_close_matches(given, names, n=3, cutoff=0.5)
    hint = f" Did you mean {', '.join(map(repr, near))}?" if near else ""
    shown = (
        ", ".join(names) if len(names) <= 24 else ", ".join(names[:24]) + f", ... ({len(names)})"
    )
    return UserError(f"Unknown {kind} {given!r}.{hint} Available: {shown or 'none'}.")
