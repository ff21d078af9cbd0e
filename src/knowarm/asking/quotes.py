"""How conditions write names: as they are, or in double quotes with backslashes before these."""

import re

from knowarm.asking.places import DISTANCES, ENDS, SIDES

QUOTED = r'"(?:[^"\\]|\\.)*"'
"""Regular expression of a name in quotes."""
KEYWORDS = {"", "and", "or", "not", "count", "is", *SIDES, *DISTANCES, *ENDS}
"""Words that are no names unless they are quoted."""


def quoted(name: str) -> str:
    """Return a name as conditions write it."""
    if name not in KEYWORDS and re.fullmatch(r'[^\s()<>=!"]+', name):
        return name
    escaped = re.sub(r'(["\\])', r"\\\1", name)
    return f'"{escaped}"'


def unquoted(word: str) -> str:
    """Return the name that a word of a condition stands for."""
    if not word.startswith('"'):
        return word
    return re.sub(r'\\(["\\])', r"\1", word[1:-1])


def condition(relation: str, value: str) -> str:
    """Return the question for what has a value of a relation, by the names of both."""
    return f"{quoted(relation)} {quoted(value)}"
