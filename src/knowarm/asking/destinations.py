"""Destinations: what has to be put where, as in "put the red mug on the kitchen's tray"."""

import re
from typing import NamedTuple

from knowarm.asking.lexicon import WORDS, what_is_put

_PUT = "|".join(sorted(WORDS.puts | WORDS.carries))
_BRING = "|".join(sorted(WORDS.brings))
_WHAT = "(?P<what>.+)"  # up to the last preposition
_TO = "(?:on ?to|in ?to|to)"
_AT = f"(?:{_TO}|on|in|at|upon|inside)"
_THE = "(?:(?:the|my|our) )?"
_WHERE = r"(?P<where>(?!(?:the|an?|my|our|any)\b)\w[\w -]*?)"
_OF = "(?:of|for|in|called|named|(?:that|which) (?:is|stands for))"
_FORMS = (
    (f"(?:(?:{_PUT}|{_BRING}) )?{_WHAT} {_AT} the tray {_OF} {_THE}{_WHERE}", True),
    (f"(?:(?:{_PUT}|{_BRING}) )?{_WHAT} {_AT} {_THE}{_WHERE}(?:['’]s?)? tray", True),
    (f"(?:{_PUT}) {_WHAT} {_AT} {_THE}{_WHERE}", True),
    (f"(?:{_BRING}) {_WHAT} {_TO} {_THE}{_WHERE}", False),
)
_ASKING = "(?:please |could you |can you |would you )*"
_SENTENCES = [
    (re.compile(rf"{_ASKING}{form}(?:,? please)?\W*", re.IGNORECASE), is_sure)
    for form, is_sure in _FORMS
]
_BEHIND_WHAT = re.compile(r" (?:back|away|over|down|up)$", re.IGNORECASE)


class Destination(NamedTuple):
    """What has to be put where."""

    what: str
    """The question for the object."""
    where: str
    """The name of a place, or the colour of a tray."""
    is_sure: bool
    """Whether the sentence says nothing else: "bring what is next to the mug" may."""


def read_destination(text: str) -> Destination | None:
    """Read what has to be put where; None of a sentence that names no destination."""
    text = text.strip()
    if what_is_put(text) != text:  # where it belongs
        return None
    for sentence, is_sure in _SENTENCES:
        said = sentence.fullmatch(text)
        if said is not None:
            what = _BEHIND_WHAT.sub("", said["what"])
            return Destination(what, said["where"], is_sure)
    return None
