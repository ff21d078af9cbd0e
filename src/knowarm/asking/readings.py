"""Readings of a question in plain English: what was read so far, and how conditions are joined."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

from knowarm.asking.quotes import quoted
from knowarm.asking.relations import NO_RELATION, Relation


@dataclass(frozen=True)
class ReadCondition:
    """A condition that was read, and how it is joined to the one before."""

    text: str
    relation: Relation = NO_RELATION
    join: str = "and"
    negated: bool = False
    inherits: bool = False  # Whether the negation is that of the one before
    is_bare: bool = False  # Whether its value alone was said
    is_new: bool = False  # Whether "something" or the like was said before it again
    is_whole: bool = False  # Whether that was said behind it: "a red object"
    name: str = ""  # "is mug" of one that is the name of an object, or holds it
    has_noun: bool = False  # Whether "something" or the like was said before it
    is_merged: bool = False  # Whether it is of several: "not a red mug"
    is_determined: bool = False  # Whether "a" or the like stands before it
    reach: str = (
        "open"  # Of its "not": a "word" ("non-red mug"), a "phrase" ("no red mug")
    )
    continues: bool = False  # Whether nothing joins it to the one before: "red mug"
    best: str = ""  # ">" or "<" of superlatives

    @property
    def is_name(self) -> bool:
        """Whether it is the name of an object, or of several conditions as one."""
        return self.name != "" or self.is_merged

    def __str__(self) -> str:
        """Return the condition with its negation."""
        return f"not {self.text}" if self.negated else self.text


Conditions = Sequence[ReadCondition]
Relations = frozenset[Relation]


@dataclass(frozen=True)
class ReadingState:
    """What one reading has read so far."""

    position: int = 0  # Of the next word
    done: tuple[ReadCondition, ...] = ()
    cost: float = 0.0
    strong: Relations | None = None  # The relations that are said; not used yet
    outer: Relations | None = None  # The same before a noun: "used for something ..."
    weak: tuple[str, ...] = ()  # Prepositions since the last condition
    noun: Relation | None = None  # The relation of a noun that is counted
    number: str = ""  # What it is compared with, as "= 2"
    best: str = ""
    join: str = ""
    negated: bool | None = None
    has_noun: bool = False  # Behind "something"
    reach: str = ""  # Of the negation, if it is known: "not anything red"
    takes_object: bool = False  # Behind a verb, whose object is left out
    left_out: tuple[int, ...] = ()  # Positions of words

    @property
    def last(self) -> Relation:
        """The relation of the last condition, one without a name before the first."""
        return self.done[-1].relation if self.done else NO_RELATION

    @property
    def is_new(self) -> bool:
        """Whether "something" or the like was said again: "red or something ..."."""
        return self.has_noun and self.join != ""

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
        return bool(self.done) and not is_open and is_clear(self.done)

    def then(self, length: int = 1, **changes: Any) -> "ReadingState":
        """Return the state behind some more words."""
        changes.setdefault("takes_object", False)
        return replace(self, position=self.position + length, **changes)

    def added(
        self, condition: ReadCondition, length: int = 0, cost: float = 0.0
    ) -> "ReadingState":
        """Return the state behind a condition, and behind some more words.

        The condition says its text, its relation and what it is; the state adds how it is joined.
        """
        continues = bool(self.done) and not self.join
        if self.reach:
            condition = replace(condition, reach=self.reach)
        if continues and self._is_negated_with(condition):
            # "not a red mug" is neither red nor a mug, and may be one of them
            *done, before = self.done
            text = before.text[1:-1] if before.is_merged else before.text
            own = replace(condition, negated=bool(self.negated))
            condition = replace(
                before,
                text=f"({text} and {own})",
                name=condition.name or before.name,
                is_whole=True,
                is_merged=True,
            )
        else:
            done = list(self.done)
            # "that is a mug" begins a phrase, as "red mug" does not
            is_name = condition.is_name and condition.is_determined
            inherits = self._inherits(condition)
            condition = replace(
                condition,
                join=self.join or "and",
                negated=bool(self.negated) or inherits,
                inherits=inherits,
                is_new=self.is_new,
                has_noun=self.has_noun,
                continues=continues and self.negated is None and not is_name,
            )
        position = self.position + length
        done.append(condition)
        cost += self.cost
        return ReadingState(position, tuple(done), cost, left_out=self.left_out)

    def _is_negated_with(self, condition: ReadCondition) -> bool:
        """Return whether the "not" before the last one negates a condition, as of a red mug."""
        before = self.done[-1]
        is_thing = before.is_name or before.is_whole or before.reach == "all"
        is_phrase = before.is_bare and condition.is_bare and self.negated is None
        is_whole = is_thing or (is_phrase and before.reach == "phrase")
        return before.negated and is_whole

    def _inherits(self, condition: ReadCondition) -> bool:
        """Return whether a condition shares the negation of the last one: "not red or blue"."""
        if self.negated is not None or self.join in ("", "but") or self.is_new:
            return False
        if self.join == "," and condition.is_determined:
            return False  # "not the mug, the bowl"
        before = self.done[-1] if self.done else condition
        is_or = self.join == "or"
        is_same = is_or or before.relation == condition.relation
        # A comma ends it behind a thing: "not the blue one, the red one"
        is_open = before.negated and (is_or or not before.is_whole)
        return is_open and is_same and condition.is_bare

    def named(
        self, condition: ReadCondition, length: int, cost: float
    ) -> Iterator["ReadingState"]:
        """Yield the state behind the name of an object, if it is clear what it ends."""
        start = self._phrase_start()
        if start == len(self.done):
            is_clear = self._is_name_clear(condition)
        else:
            is_clear = self.is_phrase_clear and self._is_named_phrase_clear(start)
        if is_clear:
            yield self._behind_phrase().added(condition, length, cost)

    def _is_name_clear(self, condition: ReadCondition) -> bool:
        """Return whether it is clear what a name belongs to that no adjective precedes."""
        if self.join not in ("and", "or") or not self.done:
            return True
        last = self.done[-1]
        if last.is_name and last.continues and not condition.is_determined:
            return False  # "the red mug or bowl"
        is_value = self.join == "or" and last.negated and not _is_thing(last)
        # "not red or a mug", "not the red mug or the bowl"
        return self.negated is not None or not (is_value or last.is_merged)

    def _is_named_phrase_clear(self, start: int) -> bool:
        """Return whether it is clear what a name belongs to that ends the phrase from one on."""
        first = self.done[start]
        if first.is_bare and first.negated and first.reach == "open":
            return False  # "not red mug"
        if not start or first.negated or first.join not in ("and", "or"):
            return True
        before = self.done[start - 1]
        return not (before.is_name and before.negated)  # "not the mug or the red bowl"

    @property
    def is_phrase_clear(self) -> bool:
        """Whether the phrase begins no other thing behind a "not": "not red or a blue one"."""
        start = self._phrase_start()
        if start == len(self.done) or not self.done[start].inherits:
            return True
        before = self.done[start - 1]
        is_thing = before.is_whole or before.is_name
        return is_thing or not self.done[start].is_determined

    def _behind_phrase(self) -> "ReadingState":
        """Return the state behind the noun of a phrase, which may be a thing of its own.

        "made of wood or a red mug" is of two things, and "a red or a blue mug" of one.
        """
        start = self._phrase_start()
        if start in (0, len(self.done)):
            return self
        first = self.done[start]
        if not first.is_determined or not _has_noun(self.done[:start]):
            return self
        phrase = (replace(first, is_new=True), *self.done[start + 1 :])
        return replace(self, done=(*self.done[:start], *phrase))

    def _phrase_start(self) -> int:
        """Return the index of the first condition of the phrase that is read: of "a red ..."."""
        start = len(self.done)
        if self.join or self.negated is not None or not start:
            return start
        start -= 1
        while start > 0 and self.done[start].continues:
            start -= 1
        return start

    @property
    def name(self) -> str:
        """The name of an object that was read last, "" without."""
        names = [condition.name for condition in self.done if condition.name]
        return "".join(names[-1:])

    @property
    def other_name(self) -> str:
        """The name that "one" stands for in another alternative: "a red mug or a blue one"."""
        is_other = False
        for condition in reversed(self.done):
            if condition.is_merged or (condition.name and is_other):
                return condition.name
            if condition.name or condition.negated:
                break
            is_other |= condition.join == "or"
        return ""

    def closed(self) -> Iterator["ReadingState"]:
        """Yield the state before "and", "or" and the end, if nothing is left open."""
        if not self.noun or self.outer is not None:
            if self.is_bare and not self.number and self.negated is None:
                yield self
            return
        if self.weak:  # "part of a clock"
            return
        state = self
        number = self.number
        if not number:
            number = "= 0" if self.negated else ">= 1"
            state = replace(self, negated=None)
        text = f"count {quoted(self.noun.name)}"
        if not self.best:
            text += f" {number}"
        cost = 0.0 if self.best or self.number else 0.3
        condition = ReadCondition(text, self.noun, best=self.best)
        yield state.added(condition, cost=cost)

    def behind_thing(self) -> "ReadingState":
        """Return the state behind "something", "object" or the like."""
        if self.noun and self.number:  # "makes at least one thing"
            return self.then()
        if self.strong is not None:  # "used for something ..."
            return self.then(outer=self.strong, strong=None, weak=(), noun=None)
        if self.done and not self.join and self.negated is None:  # "a red object"
            done = self._behind_phrase().done
            whole = replace(done[-1], is_whole=True)
            return self.then(done=(*done[:-1], whole))
        weak = self.weak
        if weak == ("of",):  # "one of the objects"
            weak = ()
        reach = self.reach
        if self.negated:  # "not anything red"
            reach = "all"
        return self.then(has_noun=True, weak=weak, reach=reach)


def _has_noun(conditions: Conditions) -> bool:
    """Return whether the last alternative of conditions is complete: "something red", "a mug"."""
    for condition in reversed(conditions):
        is_thing = condition.is_name or condition.is_whole or condition.has_noun
        if is_thing or not condition.is_bare:
            return True
        if condition.join == "or":
            return False
    return False


def is_clear(conditions: Conditions) -> bool:
    """Return whether it is clear what "and" joins and "not" reaches.

    It is not in "the mug and the bowl" and "not the red one and the blue one".
    """
    for before, condition, after in zip(
        conditions, conditions[1:], conditions[2:], strict=False
    ):
        is_contrast = condition.join == "," and before.negated > condition.negated
        if is_contrast and after.join == "or":
            return False  # "not the mug, the bowl or the jar"
    names = set[str]()
    listed = _listed(conditions)
    for before, condition in pairwise([listed[0], *listed]):
        if condition.join == "or":
            names.clear()
            if condition not in conditions and before.negated > condition.negated:
                return False  # "not red, round or blue"
        if condition.is_name and not condition.negated:
            names.add(condition.text)
        is_and = condition in conditions and condition.join == "and"
        is_exception = before.negated and before.is_whole and condition is not before
        is_bare = condition.is_bare and not condition.negated
        is_and = is_and and not condition.continues
        if len(names) > 1 or (is_exception and is_and and is_bare):
            return False
    return True


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
    for before, condition in reversed([*pairwise([ReadCondition(""), *conditions])]):
        if condition.join == ",":
            is_or = is_or and _is_in_list(before, condition)
            join = "or" if is_or else "and"
            condition = replace(condition, join=join)
        elif not condition.continues:
            is_or = condition.join == "or" and condition.is_bare
        listed.append(condition)
    return listed[::-1]


def _is_in_list(before: ReadCondition, condition: ReadCondition) -> bool:
    """Return whether two conditions are of one list, as in "a mug, red or blue" they are not."""
    is_value = before.is_bare or before.relation == condition.relation
    is_alike = _is_thing(before) == _is_thing(condition)
    return condition.is_bare and is_value and is_alike


def _is_thing(condition: ReadCondition) -> bool:
    """Return whether a condition ends or begins a thing, such as "the red one"."""
    return condition.is_name or condition.is_whole or condition.is_new


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
    values ("red or blue") and between names alone ("a mug or a bowl"), else 1.
    """
    if condition.join == "but":
        return 3
    if condition.join != "or":
        return 1
    is_of_names = before.is_name and condition.is_name and not before.continues
    if is_of_names or condition.inherits:
        return 0
    if condition.is_new or before.is_whole or before.is_name or condition.is_name:
        return 2
    is_value = condition.is_bare or condition.relation == before.relation
    return int(not is_value)


def _is_open(group: Conditions, before: Conditions, after: Conditions) -> bool:
    """Return whether "and" may bind closer than "or": "round and brown or flat and red"."""
    relations = {condition.relation for condition in group}
    is_whole = group[-1].is_whole or group[-1].is_name
    if len(relations) < 2 or is_whole:
        return False
    beside = [*before[-1:], *after[:1]]
    return any(condition.is_bare and not _is_thing(condition) for condition in beside)


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
    return " and ".join(map(_bracketed, texts))


def _bracketed(text: str) -> str:
    """Return a text, in brackets if it has an "or" outside of any."""
    outside = text
    while "(" in outside:
        outside = re.sub(r"\([^()]*\)", "", outside)
    return f"({text})" if " or " in outside else text
