"""Names people chose go in; names that are safe in files and addresses come out."""

import re
from collections.abc import Iterable


def slugs(names: Iterable[str]) -> dict[str, str]:
    """One slug a name: lower-case letters, digits, "+" and "-", no two alike.

    Args:
        names: titles of tasks or names of agents, each once.
    """
    found: dict[str, str] = {}
    for name in names:
        base = re.sub(r"[^a-z0-9+]+", "-", name.lower()).strip("-") or "x"
        slug, number = base, 2
        while slug in found.values():
            slug, number = f"{base}-{number}", number + 1
        found[name] = slug
    return found
