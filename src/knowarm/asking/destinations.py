"""Destinations: what has to be put where, as in "put the red mug on the kitchen's tray"."""

import re
from typing import NamedTuple

from knowarm.asking.lexicon import DESTINATIONS, match_putting, what_is_put

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
    for form in DESTINATIONS:
        match = match_putting(form["pattern"], text)
        if match is not None:
            what = _BEHIND_WHAT.sub("", match["what"])
            return Destination(what, match["where"], form["is_sure"])
    return None
