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

    def __str__(self) -> str:
        """Return the condition with its negation."""
        return f"not {self.text}" if self.negated else self.text


def joined(conditions: Sequence[ReadCondition]) -> str:
    """Return conditions as one question, or "" if they can be joined in several ways.

    "but" joins last, "or" between things next, and "or" between values first.
    """
    texts = list[str]()
    for segment in _split(_listed(conditions), _is_contrast):
        alternatives = list[str]()
        for phrase in _split(segment, _is_thing):
            groups = _split(phrase, _is_no_value)
            joins = {group[0].join for group in groups[1:]}
            if len(joins) > 1 or any(
                map(_is_open, groups, [[], *groups], [*groups[1:], []])
            ):
                return ""
            group_texts = list(map(_either, groups))
            if joins == {"or"}:
                alternatives += group_texts
            else:
                alternatives.append(_both(group_texts))
        texts.append(" or ".join(alternatives))
    return _both(texts)


def _listed(conditions: Sequence[ReadCondition]) -> list[ReadCondition]:
    """Return conditions with the joins of lists: "red, green or blue" is "or" throughout."""
    listed = list[ReadCondition]()
    after = None  # the next condition, or this one, that no comma joins
    for condition in reversed(conditions):
        if condition.join != ",":
            after = condition
            listed.append(condition)
        elif (
            after is not None
            and after.join == "or"
            and after.is_bare
            and condition.is_bare
        ):
            listed.append(replace(condition, join="or"))
        else:
            listed.append(replace(condition, join="and"))
    return listed[::-1]


def _split(
    conditions: Sequence[ReadCondition],
    begins: Callable[[ReadCondition, ReadCondition], bool],
) -> list[list[ReadCondition]]:
    """Split conditions before those that begin a group, seen beside the one before."""
    groups = [[conditions[0]]]
    for before, condition in pairwise(conditions):
        if begins(condition, before):
            groups.append([])
        groups[-1].append(condition)
    return groups


def _is_contrast(condition: ReadCondition, before: ReadCondition) -> bool:
    """Return whether "but" joins a condition to the one before."""
    return condition.join == "but"


def _is_thing(condition: ReadCondition, before: ReadCondition) -> bool:
    """Return whether "or" stands between things: "a red object or something round"."""
    return condition.join == "or" and (condition.is_new or before.is_whole)


def _is_no_value(condition: ReadCondition, before: ReadCondition) -> bool:
    """Return whether a condition does not go on with the value before it, as in "red or blue"."""
    is_value = condition.is_bare or condition.relation == before.relation
    return condition.join != "or" or not is_value


def _is_open(
    group: Sequence[ReadCondition],
    before: Sequence[ReadCondition],
    after: Sequence[ReadCondition],
) -> bool:
    """Return whether "and" may bind closer than "or": "round and brown or flat and red"."""
    relations = {condition.relation for condition in group}
    if len(relations) < 2 or group[-1].is_whole:
        return False
    return any(condition.is_bare for condition in (*before[-1:], *after[:1]))


def _either(group: Sequence[ReadCondition]) -> str:
    """Return conditions of which one is true; "not red or blue" is neither."""
    inherit = all(condition.inherits for condition in group[1:])
    if len(group) > 1 and group[0].negated and inherit:
        return f"not ({' or '.join(condition.text for condition in group)})"
    return " or ".join(map(str, group))


def _both(texts: Sequence[str]) -> str:
    """Return texts that are all true, in brackets where "or" would reach further."""
    if len(texts) == 1:
        return texts[0]
    bracketed = list[str]()
    for text in texts:
        is_open = " or " in text and not text.startswith("not (")
        bracketed.append(f"({text})" if is_open else text)
    return " and ".join(bracketed)
