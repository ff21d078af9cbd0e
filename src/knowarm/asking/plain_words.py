"""Questions in plain English, read as those of `expressions` by the vocabulary of a graph.

    something to drink from that is not red  ->  usedFor drinking and not hasColor red

Every word is accounted for: as a value, as a cue for a relation ("made of"), as one that joins or
negates, or as one of a few that change nothing. All readings are enumerated, and the nearest one
counts if it is the only one. Anything else is refused, with the nearest conditions of the graph.
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import chain, compress, count, product

from knowarm.asking.joining import ReadCondition, joined
from knowarm.asking.lexicon import (
    FAMILIES,
    INFLECTED,
    JOINS,
    NUMBER,
    WEAK,
    WORDS,
    distance,
    near,
    tokens,
)
from knowarm.asking.vocabulary import Entry, Vocabulary
from knowarm.errors import UserError

Holders = Callable[[str], set[int]]
"""The entities of which a question is true."""

_THINGS = set(WORDS["things"])
_NEGATIONS = set(WORDS["negations"])
_REQUESTS = set(WORDS["requests"])
_ABLE = set(WORDS["able"])
_IGNORED = _THINGS.union(WORDS["ignored"])
_NO_VALUE = _IGNORED.union(_NEGATIONS, WEAK, JOINS)
_COMPARED = re.compile(rf"((?:[<>!]=?|=)?)({NUMBER})")
MOST_WORDS = 60
MOST_READINGS = 2_000
"""Most words of a question, and most steps of its readings."""


@dataclass(frozen=True)
class _State:
    """What one reading has read so far."""

    done: tuple[ReadCondition, ...] = ()
    cost: float = 0.0
    strong: frozenset[str] | None = None  # The relations that are said; not used yet
    outer: frozenset[str] | None = (
        None  # The same before a noun: "used for something ..."
    )
    weak: tuple[str, ...] = ()  # Prepositions since the last condition
    noun: str = ""  # The relation of a noun that is counted
    number: str = ""
    best: str = ""
    join: str = ""
    negated: bool | None = None
    is_new: bool = False

    @property
    def last(self) -> str:
        """The relation of the last condition, "" before the first."""
        return self.done[-1].relation if self.done else ""

    @property
    def is_bare(self) -> bool:
        """Whether no relation was said since the last condition."""
        return self.strong is None and self.outer is None and not self.weak

    def is_end(self) -> bool:
        """Return whether the question may end here."""
        is_open = self.is_new or self.negated is not None or self.join not in ("", ",")
        return bool(self.done) and not is_open


class _Reader:
    """Enumerates the readings of a question."""

    def __init__(self, text: str, vocabulary: Vocabulary) -> None:
        self.text = text
        self.vocabulary = vocabulary
        self.words = tokens(text)
        if not 0 < len(self.words) <= MOST_WORDS:
            raise self.refused(
                f"it has {len(self.words)} words, allowed are 1 to {MOST_WORDS}"
            )
        self.matches = [list(self.match(start)) for start in range(len(self.words))]

    def refused(self, why: str) -> UserError:
        """Return the error of a question that is not understood, with the nearest conditions."""
        near = self.vocabulary.nearest(
            [word for word in self.words if word not in _NO_VALUE]
        )
        return UserError(f"The question {self.text!r} is not understood: {why}. {near}")

    def best(self) -> list[ReadCondition]:
        """Return the conditions of the nearest reading."""
        if self.words[0] in WORDS["unanswered"]:
            raise self.refused("only questions for an object are answered")
        reached = [dict[_State, None]() for _ in range(len(self.words) + 1)]  # in order
        reached[0][_State()] = None
        for start, states in enumerate(reached[:-1]):
            for state in states:
                for length, following in self.following(start, state):
                    reached[start + length][following] = None
            if len(states) > MOST_READINGS:
                raise self.refused("it can be read in too many ways")
        ends = filter(_State.is_end, chain.from_iterable(map(self.closed, reached[-1])))
        readings = dict[str, _State]()
        for end in sorted(ends, key=lambda state: state.cost):
            readings.setdefault(joined(end.done), end)
        if not readings:
            raise self.refused(self.reason(max(compress(count(), reached))))
        nearest = next(iter(readings.values()))
        most = nearest.cost + INFLECTED / 2
        texts = [text for text, end in readings.items() if end.cost < most]
        if len(texts) > 1:
            raise self.refused(f"it may mean {', or '.join(texts[:3])}")
        if not texts[0]:
            first, second, *_, last = nearest.done
            remedy = f"write it with brackets, as ({first} or {second}) and {last}"
            raise self.refused(
                f"'and' and 'or' can be joined in several ways; {remedy}"
            )
        return list(nearest.done)

    def reason(self, furthest: int) -> str:
        """Return why there is no reading, all of which end at a word."""
        for length, start in product((3, 2, 1), range(len(self.words))):
            if self.is_object(start, length):
                name = " ".join(self.words[start : start + length])
                return f"{name!r} names an object, and a question describes it instead"
        if furthest == len(self.words):
            return "its parts do not fit together"
        return f"{self.words[furthest]!r} fits nothing here"

    def following(self, start: int, state: _State) -> Iterator[tuple[int, _State]]:
        """Yield what may be read next: a number of words, and the state behind them."""
        word = self.words[start]
        if self.is_object(start, 3) or self.is_object(start, 2):
            return
        if _COMPARED.fullmatch(word):
            yield from self.numbered(start, state)
            return
        if word == "one" and self.vocabulary.noun(self.after(start), counted=True):
            yield 1, replace(state, number="1", weak=())
        if state.noun and state.outer is None:  # "more than two parts that ..."
            for closed in self.closed(state):
                yield from self.following(
                    start, replace(closed, cost=closed.cost + INFLECTED)
                )
        yield from self.values(start, state)
        for entry, far in self.matches[start]:
            if len(entry.words) > 1 and far <= INFLECTED:
                return  # the "living room" is no room where something lives
        yield from self.superlatives(start, state)
        if word in JOINS:
            yield from self.joins(start, state)
        elif word in _NEGATIONS:
            yield from self.negations(word, state)
        elif not self.is_object(start, 1):
            yield from self.cues(start, state)

    def joins(self, start: int, state: _State) -> Iterator[tuple[int, _State]]:
        """Yield the states behind "and", "or", "but" or a comma."""
        word = self.words[start]
        said = state.strong or state.outer
        if word == "but" and (said or self.words[start - 1] in WORDS["any"]):
            # "any colour but blue", "made of anything but metal"
            yield 1, replace(state, strong=said, outer=None, negated=True, noun="")
            return
        for closed in self.closed(state):
            join = JOINS[word]
            if join == "," and closed.join:
                join = closed.join
            if closed.done or not closed.join:
                yield 1, replace(closed, join=join, negated=None)

    def negations(self, word: str, state: _State) -> Iterator[tuple[int, _State]]:
        """Yield the state behind "not", "without" or the like."""
        if state.outer is not None or state.number:
            return
        weak = state.weak
        if word.startswith(("without", "lack")):
            weak += ("with",)
        join = state.join
        if word == "nor":
            join = join or "and"
        yield (
            1,
            replace(state, weak=weak, join=join, noun="", negated=not state.negated),
        )

    def cues(self, start: int, state: _State) -> Iterator[tuple[int, _State]]:
        """Yield the state behind a word that says a relation, or changes nothing."""
        word = self.words[start]
        last = "" if state.join else state.last
        said = self.vocabulary.said(word)
        if said:
            both = said if state.strong is None else said & state.strong
            if both:
                is_counted = bool(state.number) or self.words[start - 1] == "no"
                noun = self.vocabulary.noun(word, is_counted)
                yield 1, replace(state, strong=both, noun=noun)
            is_location = word == "used" and self.after(start) in ("in", "at", "on")
            if (
                state.strong is None
                and not state.weak
                and (last in said or is_location)
            ):
                yield 1, state  # "round shape", "red in colour", "used in the kitchen"
        if word in WEAK:
            yield 1, replace(state, weak=(*state.weak, word))
            if last and (
                word != "with" or self.vocabulary.family(last) is FAMILIES["use"]
            ):
                yield 1, replace(state, cost=state.cost + 0.01)  # "to drink from"
            if start and self.words[start - 1] in _REQUESTS and not state.done:
                yield 1, state  # "look for", "want to"
        if word in _THINGS:
            yield 1, self.thing(state)
        elif word in _ABLE and not state.weak:
            yield 1, replace(state, weak=("to",))
            yield 1, state
        elif word in _IGNORED or word in _ABLE:
            yield 1, state
        if word in _REQUESTS and not (state.done or state.strong or state.weak):
            yield 1, state

    def thing(self, state: _State) -> _State:
        """Return the state behind "something", "object" or the like."""
        if state.strong is not None:  # "used for something ..."
            return replace(state, outer=state.strong, strong=None, weak=(), noun="")
        if state.done and not state.join:  # "a red object"
            whole = replace(state.done[-1], is_whole=True)
            return replace(state, done=(*state.done[:-1], whole))
        state = replace(state, is_new=bool(state.join))
        if state.weak == ("of",):  # "one of the objects"
            return replace(state, weak=())
        return state

    def is_object(self, start: int, length: int) -> bool:
        """Return whether words are the name of an object, and no value."""
        words = self.words[start : start + length]
        if words == ["can"] and self.after(start) not in {*JOINS, *WEAK, "that"}:
            return False  # the verb
        if self.matches[start]:
            return False
        return any(
            len(words) == len(name) == length and all(map(_is_same, words, name))
            for name in self.vocabulary.objects
        )

    def after(self, start: int) -> str:
        """Return the word behind another one, or a comma at the end."""
        return self.words[start + 1] if start + 1 < len(self.words) else ","

    def is_purpose(self, start: int, state: _State) -> bool:
        """Return whether a value that is a verb may be meant: not by "light" and "stored"."""
        word = self.words[start]
        before = self.words[start - 1] if start else ""
        if word.endswith("s") and before in ("that", "which", "what"):
            return True
        is_said = state.strong is not None or "for" in state.weak or "to" in state.weak
        continues = bool(state.join and state.done) and "ing" in state.done[-1].text
        return (is_said or continues) and not word.endswith("ed")

    def match(self, start: int) -> Iterator[tuple[Entry, float]]:
        """Yield the values that may be meant by the words from one on, and how far they are."""
        if self.words[start] in _NO_VALUE:
            return
        for first, entries in self.vocabulary.by_first.items():
            if distance(self.words[start], first) is None:
                continue
            for entry in entries:
                words = self.words[start : start + len(entry.words)]
                distances = list(map(distance, words, entry.words))
                if len(words) == len(entry.words) and None not in distances:
                    yield entry, sum(filter(None, distances))

    def values(self, start: int, state: _State) -> Iterator[tuple[int, _State]]:
        """Yield the states behind the values that stand at a place."""
        if state.number or state.best:
            return
        matches = self.matches[start]
        longest = max((len(entry.words) for entry, _ in matches), default=0)
        for entry, far in matches:
            if len(entry.words) < longest:
                continue
            is_verb = far == INFLECTED and entry.words[-1].endswith("ing")
            if is_verb and not self.is_purpose(start, state):
                continue
            if far and state.weak[-1:] == ("for",) and self.is_exact(start, entry):
                continue  # "for water" is not to water, though "water" is its verb
            cost = self.fits(entry, state)
            if cost is not None:
                condition = ReadCondition(
                    entry.text, entry.relation, is_bare=state.is_bare
                )
                yield longest, self.added(state, condition, far + cost)

    def is_exact(self, start: int, entry: Entry) -> bool:
        """Return whether the words from one on are exactly another value than that of an entry."""
        for other, far in self.matches[start]:
            if far == 0 and not other.inner and other.text != entry.text:
                return True
        return False

    def fits(self, entry: Entry, state: _State) -> float | None:
        """Return what it costs to read a value by the words before it, None if it cannot be."""
        relation = entry.relation
        if state.outer is not None:
            return 0.0 if self.fits_chain(entry, state) else None
        if entry.inner and self.vocabulary.family(entry.inner) is not FAMILIES["type"]:
            return None
        cost = 0.5 if entry.inner else 0.0
        is_allowed = any(self.vocabulary.allows(word, relation) for word in state.weak)
        if state.strong is not None:
            prepositions = WEAK.intersection(self.vocabulary.words[relation][1:])
            if prepositions and state.weak and not is_allowed:
                return None  # "made by" is not "made of"
            return cost if relation in state.strong else None
        if state.weak:
            return cost if is_allowed else None
        last = state.last if state.join else ""
        family = self.vocabulary.family(relation)
        if relation == last:
            return cost
        if entry.inner or family.relations == "":
            return None
        if family.describes and not last:
            return 0.0
        if family.describes or not state.done:
            return 0.05
        return None

    def fits_chain(self, entry: Entry, state: _State) -> bool:
        """Return whether a value can be read as what a thing is, that was said before it."""
        if not entry.inner or state.outer is None or entry.relation not in state.outer:
            return False
        if state.strong is not None and entry.inner in state.strong:
            return True
        return any(self.vocabulary.allows(word, entry.inner) for word in state.weak)

    def added(
        self, state: _State, condition: ReadCondition, cost: float = 0.0
    ) -> _State:
        """Return the state behind a condition."""
        join = state.join or "and"
        inherits = False
        if state.negated is None and state.done and state.join and not state.is_new:
            before = state.done[-1]
            is_same = before.relation == condition.relation or join == "or"
            is_open = (
                before.negated and not before.is_whole
            )  # "not the blue one, the red one"
            inherits = is_open and condition.is_bare and is_same and join != "but"
        whole = replace(
            condition,
            join=join,
            negated=inherits if state.negated is None else state.negated,
            inherits=inherits,
            is_new=state.is_new,
        )
        return _State(done=(*state.done, whole), cost=state.cost + cost)

    def closed(self, state: _State) -> Iterator[_State]:
        """Yield the state before "and", "or" and the end, if nothing is left open."""
        if not state.noun or state.outer is not None:
            if state.is_bare and not state.number:
                yield state
            return
        number = state.number
        cost = 0.0
        if not number:
            number = "=0" if state.negated else ">=1"
            cost = 0.3
            state = replace(state, negated=None)
        text = f"count {state.noun}"
        if state.best:
            cost = 0.0
        else:
            text = self.compared(text, number)
        yield self.added(state, ReadCondition(text, state.noun, best=state.best), cost)

    def compared(self, text: str, number: str) -> str:
        """Return a comparison with a number that may have a sign."""
        sign, digits = _COMPARED.findall(number)[0]
        return f"{text} {sign or '='} {digits}"

    def numbered(self, start: int, state: _State) -> Iterator[tuple[int, _State]]:
        """Yield the states behind a number: compared with what was said, or of what follows."""
        number = self.words[start]
        length = 1 + (self.after(start) in WORDS["money"])
        for relation in sorted(state.strong or ()):
            if self.vocabulary.numbers(relation):
                text = self.compared(relation, number)
                yield length, self.added(state, ReadCondition(text, relation))
        if state.noun:
            yield 1, replace(state, number=number)
        elif state.strong is None and "-" not in number and "." not in number:
            yield 1, replace(state, number=number, weak=())

    def superlatives(self, start: int, state: _State) -> Iterator[tuple[int, _State]]:
        """Yield the states behind "most parts", "the cheapest", "lowest price", "cheaper than"."""
        word, *after = (*self.words[start : start + 5], *[""] * 4)
        extreme = "max" if word in WORDS["largest"] else "min"
        if extreme == "max" or word in WORDS["smallest"]:
            yield 1, replace(state, best=extreme, weak=())
            for relation in sorted(self.vocabulary.said(after[0])):
                if self.vocabulary.numbers(relation):
                    yield (
                        2,
                        self.added(
                            state, ReadCondition(relation, relation, best=extreme)
                        ),
                    )
        adjective = word
        length = 1
        if word in ("most", "least", "more", "less"):
            adjective = after.pop(0)
            length = 2
        relation, sign = self.vocabulary.measured(adjective)
        if not relation:
            return
        if word in ("least", "less"):
            sign = "<" if sign == ">" else ">"
        if word.endswith("est") or word in ("most", "least"):
            extreme = "max" if sign == ">" else "min"
            yield (
                length,
                self.added(state, ReadCondition(relation, relation, best=extreme)),
            )
        elif after[0] == "than" and re.fullmatch(NUMBER, after[1]):
            length += 2 + (after[2] in WORDS["money"])
            text = f"{relation} {sign} {after[1]}"
            yield length, self.added(state, ReadCondition(text, relation))


def _is_same(word: str, other: str) -> bool:
    """Return whether words are the same, in singular or plural."""
    return near(word, other, 0)


def read_plain(text: str, vocabulary: Vocabulary, holders: Holders) -> str:
    """Read a question in plain English, as `expressions` write it.

    Args:
        text: the question.
        vocabulary: what can be asked.
        holders: tells of which entities a question is true, for superlatives.

    Raises:
        UserError: the question is not understood, or can be understood in several ways.
    """
    reader = _Reader(text, vocabulary)
    conditions = reader.best()
    best = [condition for condition in conditions if condition.best]
    rest = [condition for condition in conditions if not condition.best]
    if not best:
        return joined(conditions)
    is_or = any(condition.join == "or" for condition in conditions)
    if len(best) > 1 or best[0].negated or is_or:
        raise reader.refused("of superlatives it may hold one, which only 'and' joins")
    superlative = best[0]
    if superlative.text.startswith("count "):
        numbers = vocabulary.counts(superlative.relation)
    else:
        numbers = vocabulary.numbers(superlative.relation)
    among = holders(joined(rest)) if rest else set(vocabulary.heads)
    values = [number for head, number in numbers.items() if head in among]
    if not values:
        raise reader.refused(
            f"no object that it is about has a number of {superlative.relation}"
        )
    extreme = max(values) if superlative.best == "max" else min(values)
    return joined([*rest, ReadCondition(f"{superlative.text} = {extreme:g}")])
