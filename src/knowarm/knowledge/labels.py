"""A name of the graph goes in; the words a person would read comes out."""

import re
from collections.abc import Mapping

from knowarm.knowledge.term import local_name

_CAMEL = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
_SPACE = re.compile(r"[\s_\-]+")


def label_of(name: str, labels: Mapping[str, str]) -> str:
    """Return the label of an entity or relation, lower case, words parted by one space.

    A written label (rdfs:label) stands as it is. Otherwise the last part of the name is split at
    `_`, `-` and camelCase: `hasColor` -> "has color", `light_blue` -> "light blue".
    """
    written = labels.get(name)
    text = written if written is not None else _CAMEL.sub(" ", local_name(name))
    return _SPACE.sub(" ", text).strip().lower()
