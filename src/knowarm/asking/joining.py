"""Joining of conditions that were read from plain English, by "and", "or", "but" and "not"."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise


@dataclass(frozen=True)
class ReadCondition:
    """A condition that was read, and how it is joined to the one before."""

    text: str
    relation: str = ""
    join: str = "and"
    negated: bool = False
    inherits: bool = False  # Whether the negation is that of the one before
    is_bare: bool = False  # Whether its value alone was said
    is_new: bool = False  # Whether "something" or the like was said before it again
    is_whole: bool = False  # Whether that was said behind it: "a red object"
    best: str = ""  # "max" or "min" of superlatives


def joined(conditions: Sequence[ReadCondition]) -> str:
    """Return conditions as one question, or "" if they can be joined in several ways.

    "but" joins last, "or" between things next, and "or" between values first.
    """
    texts = list[str]()
    for segment in _split(_listed(conditions), lambda each, _: each.join == "but"):
        alternatives = list[str]()
        for phrase in _split(segment, _is_thing):
            groups = _split(phrase, lambda each, before: not _is_value(each, before))
            joins = {group[0].join for group in groups[1:]}
            if len(joins) > 1 or any(map(_is_open, groups, [[], *groups], [*groups[1:], []])):
                return ""
            parts = [_either(group) for group in groups]
            alternatives += parts if joins == {"or"} else [_both(parts)]
        texts.append(" or ".join(alternatives))
    return _both(texts)


def _listed(conditions: Sequence[ReadCondition]) -> list[ReadCondition]:
    """Return conditions with the joins of lists: "red, green or blue" is "or" throughout."""
    found = list[ReadCondition]()
    for number, each in enumerate(conditions):
        after = next((c for c in conditions[number:] if c.join != ","), None)
        is_or = after is not None and after.join == "or" and after.is_bare and each.is_bare
        found.append(replace(each, join={",": "or" if is_or else "and"}.get(each.join, each.join)))
    return found


def _split(
    conditions: Sequence[ReadCondition], begins: Callable[[ReadCondition, ReadCondition], bool]
) -> list[list[ReadCondition]]:
    """Split conditions before those that begin a part, seen beside the one before."""
    parts = [[conditions[0]]]
    for before, each in pairwise(conditions):
        parts += [[]] if begins(each, before) else []
        parts[-1].append(each)
    return parts


def _is_thing(condition: ReadCondition, before: ReadCondition) -> bool:
    """Return whether "or" stands between things: "a red object or something round"."""
    return condition.join == "or" and (condition.is_new or before.is_whole)


def _is_value(condition: ReadCondition, before: ReadCondition) -> bool:
    """Return whether "or" joins a condition to the value before it: "red or blue"."""
    return condition.join == "or" and (condition.is_bare or condition.relation == before.relation)


def _is_open(
    group: Sequence[ReadCondition],
    before: Sequence[ReadCondition],
    after: Sequence[ReadCondition],
) -> bool:
    """Return whether "and" may bind closer than "or": "round and brown or flat and red"."""
    mixed = len({each.relation for each in group}) > 1 and not group[-1].is_whole
    return mixed and any(each.is_bare for each in (*before[-1:], *after[:1]))


def _either(group: Sequence[ReadCondition]) -> str:
    """Return conditions of which one is true; "not red or blue" is neither."""
    negates = len(group) > 1 and group[0].negated and all(c.inherits for c in group[1:])
    texts = [c.text if negates or not c.negated else f"not {c.text}" for c in group]
    return f"not ({' or '.join(texts)})" if negates else " or ".join(texts)


def _both(parts: Sequence[str]) -> str:
    """Return parts that are all true."""
    return " and ".join(
        f"({part})" if " or " in part and len(parts) > 1 and not part.startswith("not (") else part
        for part in parts
    )
