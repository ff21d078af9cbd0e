"""Readings of a question in plain English: what was read so far, and how conditions are joined."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any


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
    best: str = ""  # ">" or "<" of superlatives

    def __str__(self) -> str:
        """Return the condition with its negation."""
        return f"not {self.text}" if self.negated else self.text


Conditions = Sequence[ReadCondition]
Relations = frozenset[str]


@dataclass(frozen=True)
class ReadingState:
    """What one reading has read so far."""

    position: int = 0  # Of the next word
    done: tuple[ReadCondition, ...] = ()
    cost: float = 0.0
    strong: Relations | None = None  # The relations that are said; not used yet
    outer: Relations | None = None  # The same before a noun: "used for something ..."
    weak: tuple[str, ...] = ()  # Prepositions since the last condition
    noun: str = ""  # The relation of a noun that is counted
    number: str = ""  # What it is compared with, as "= 2"
    best: str = ""
    join: str = ""
    negated: bool | None = None
    is_new: bool = False

    @property
    def last(self) -> str:
        """The relation of the last condition, "" before the first."""
        return self.done[-1].relation if self.done else ""

    @property
    def is_unsaid(self) -> bool:
        """Whether no word for a relation was read since the last condition or noun."""
        return self.strong is None and not self.weak

    @property
    def is_bare(self) -> bool:
        """Whether no relation was said since the last condition."""
        return self.is_unsaid and self.outer is None

    def is_end(self) -> bool:
        """Return whether the question may end here."""
        is_open = self.is_new or self.negated is not None or self.join not in ("", ",")
        return bool(self.done) and not is_open

    def then(self, length: int = 1, **changes: Any) -> "ReadingState":
        """Return the state behind some more words."""
        return replace(self, position=self.position + length, **changes)

    def added(
        self,
        text: str,
        relation: str,
        length: int = 0,
        cost: float = 0.0,
        is_bare: bool = False,
        best: str = "",
    ) -> "ReadingState":
        """Return the state behind a condition, and behind some more words."""
        join = self.join or "and"
        inherits = False
        if self.negated is None and self.done and self.join and not self.is_new:
            before = self.done[-1]
            is_same = before.relation == relation or join == "or"
            # It ends with a thing: "not the blue one, the red one"
            is_open = before.negated and not before.is_whole
            inherits = is_open and is_bare and is_same and join != "but"
        condition = ReadCondition(
            text,
            relation,
            join,
            negated=self.negated or inherits,
            inherits=inherits,
            is_bare=is_bare,
            is_new=self.is_new,
            best=best,
        )
        return ReadingState(
            self.position + length, (*self.done, condition), self.cost + cost
        )

    def closed(self) -> Iterator["ReadingState"]:
        """Yield the state before "and", "or" and the end, if nothing is left open."""
        if not self.noun or self.outer is not None:
            if self.is_bare and not self.number:
                yield self
            return
        state = self
        number = self.number
        if not number:
            number = "= 0" if self.negated else ">= 1"
            state = replace(self, negated=None)
        text = f"count {self.noun}"
        cost = 0.0
        if not self.best:
            text += f" {number}"
            if not self.number:
                cost = 0.3
        yield state.added(text, self.noun, cost=cost, best=self.best)

    def behind_thing(self) -> "ReadingState":
        """Return the state behind "something", "object" or the like."""
        if self.strong is not None:  # "used for something ..."
            return self.then(outer=self.strong, strong=None, weak=(), noun="")
        if self.done and not self.join:  # "a red object"
            whole = replace(self.done[-1], is_whole=True)
            return self.then(done=(*self.done[:-1], whole))
        weak = self.weak
        if weak == ("of",):  # "one of the objects"
            weak = ()
        return self.then(is_new=bool(self.join), weak=weak)


def joined(conditions: Conditions) -> str:
    """Return conditions as one question, or "" if they can be joined in several ways.

    "but" joins last, "or" between things next, and "or" between values first.
    """
    texts = []
    for segment in _split(_listed(conditions), 3):
        alternatives = []
        for phrase in _split(segment, 2):
            groups = _split(phrase, 1)
            joins = {group[0].join for group in groups[1:]}
            beside = [[], *groups, []]
            if len(joins) > 1 or any(map(_is_open, groups, beside, beside[2:])):
                return ""
            group_texts = list(map(_either, groups))
            if joins == {"or"}:
                alternatives += group_texts
            else:
                alternatives.append(_both(group_texts))
        texts.append(" or ".join(alternatives))
    return _both(texts)


def _listed(conditions: Conditions) -> list[ReadCondition]:
    """Return conditions with the joins of lists: "red, green or blue" is "or" throughout."""
    listed = []
    is_or = False  # of the next condition, or this one, that no comma joins
    for condition in reversed(conditions):
        if condition.join == ",":
            join = "or" if is_or and condition.is_bare else "and"
            condition = replace(condition, join=join)
        else:
            is_or = condition.join == "or" and condition.is_bare
        listed.append(condition)
    return listed[::-1]


def _split(conditions: Conditions, gap: int) -> list[list[ReadCondition]]:
    """Split conditions where those beside each other are so far apart."""
    groups = [[conditions[0]]]
    for before, condition in pairwise(conditions):
        if _gap(before, condition) == gap:
            groups.append([])
        groups[-1].append(condition)
    return groups


def _gap(before: ReadCondition, condition: ReadCondition) -> int:
    """Return how far apart two conditions are.

    3 by "but", 2 by "or" between things ("a red object or something round"), 0 by "or" between
    values ("red or blue"), else 1.
    """
    if condition.join == "but":
        return 3
    if condition.join != "or":
        return 1
    if condition.is_new or before.is_whole:
        return 2
    is_value = condition.is_bare or condition.relation == before.relation
    return int(not is_value)


def _is_open(group: Conditions, before: Conditions, after: Conditions) -> bool:
    """Return whether "and" may bind closer than "or": "round and brown or flat and red"."""
    relations = {condition.relation for condition in group}
    if len(relations) < 2 or group[-1].is_whole:
        return False
    return any(condition.is_bare for condition in (*before[-1:], *after[:1]))


def _either(group: Conditions) -> str:
    """Return conditions of which one is true; "not red or blue" is neither."""
    inherit = all(condition.inherits for condition in group[1:])
    if len(group) > 1 and group[0].negated and inherit:
        return f"not ({' or '.join(condition.text for condition in group)})"
    return " or ".join(map(str, group))


def _both(texts: Sequence[str]) -> str:
    """Return texts that are all true, in brackets where "or" would reach further."""
    if len(texts) == 1:
        return texts[0]
    bracketed = []
    for text in texts:
        is_open = " or " in text and not text.startswith("not (")
        bracketed.append(f"({text})" if is_open else text)
    return " and ".join(bracketed)
