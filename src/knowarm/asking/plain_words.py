"""Questions in plain English, read as those of `expressions` by the vocabulary of a graph.

    something to drink from that is not red  ->  usedFor drinking and not hasColor red

Every word is accounted for: as a value, as a cue for a relation ("made of"), as one that joins or
negates, or as one of a few that change nothing. All readings are enumerated, and the nearest one
counts if it is the only one. Anything else is refused, with the nearest conditions of the graph.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import chain, compress, count
from operator import attrgetter

from knowarm.asking.lexicon import (
    FAMILIES,
    INFLECTED,
    JOINS,
    NUMBER,
    WEAK,
    WORDS,
    distance,
    tokens,
)
from knowarm.asking.readings import ReadCondition, ReadingState, joined
from knowarm.asking.vocabulary import Entry, Vocabulary
from knowarm.errors import UserError

Holders = Callable[[str], set[int]]
"""The entities of which a question is true."""

States = Iterator[ReadingState]

_IGNORED = {*WORDS["things"], *WORDS["ignored"]}
_NO_VALUE = {*_IGNORED, *WORDS["negations"], *WEAK, *JOINS}
_COMPARED = re.compile(rf"((?:[<>!]=?|=)?)({NUMBER})")
_BEST = dict.fromkeys(WORDS["largest"], ">") | dict.fromkeys(WORDS["smallest"], "<")
MOST_WORDS = 60
MOST_READINGS = 2_000
"""Most words of a question, and most steps of its readings."""
LONGEST_NAME = 3
"""Most words of an object's name that is recognized."""


class _Reader:
    """Enumerates the readings of a question: each rule yields what a state may become."""

    def __init__(self, text: str, vocabulary: Vocabulary) -> None:
        self.text = text
        self.vocabulary = vocabulary
        self.words = tokens(text)
        if not 0 < len(self.words) <= MOST_WORDS:
            raise self.refused(
                f"it has {len(self.words)} words, allowed are 1 to {MOST_WORDS}"
            )
        starts = range(len(self.words))
        self.matches = [list(self.match(start)) for start in starts]
        self.object_lengths = list(map(self.object_length, starts))

    def refused(self, why: str) -> UserError:
        """Return the error of a question that is not understood, with the nearest conditions."""
        values = [word for word in self.words if word not in _NO_VALUE]
        nearest = self.vocabulary.nearest(values)
        return UserError(
            f"The question {self.text!r} is not understood: {why}. {nearest}"
        )

    def best(self) -> tuple[ReadCondition, ...]:
        """Return the conditions of the nearest reading."""
        if self.words[0] in WORDS["unanswered"]:
            raise self.refused("only questions for an object are answered")
        # By position, in order, once each
        reached = [dict[ReadingState, None]() for _ in range(len(self.words) + 1)]
        reached[0][ReadingState()] = None
        for states in reached[:-1]:
            for state in states:
                for following in self.following(state):
                    reached[following.position][following] = None
            if len(states) > MOST_READINGS:
                raise self.refused("it can be read in too many ways")
        closed = chain.from_iterable(map(ReadingState.closed, reached[-1]))
        ends = filter(ReadingState.is_end, closed)
        readings: dict[str, ReadingState] = {}
        for end in sorted(ends, key=attrgetter("cost")):
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
        return nearest.done

    def reason(self, furthest: int) -> str:
        """Return why there is no reading, all of which end at a word."""
        length = max(self.object_lengths)
        if length:
            start = self.object_lengths.index(length)
            name = " ".join(self.words[start : start + length])
            return f"{name!r} names an object, and a question describes it instead"
        if furthest == len(self.words):
            return "its parts do not fit together"
        return f"{self.words[furthest]!r} fits nothing here"

    def word(self, position: int) -> str:
        """Return the word at a position, or a comma behind the end."""
        return self.words[position] if position < len(self.words) else ","

    def apart(self, start: int, name: Sequence[str]) -> float | None:
        """Return how far the words from one on are from a name, None if they are not it."""
        words = self.words[start : start + len(name)]
        if len(words) < len(name):
            return None
        total = 0.0
        for far in map(distance, words, name):
            if far is None:
                return None
            total += far
        return total

    def match(self, start: int) -> Iterator[tuple[Entry, float]]:
        """Yield the values that may be meant by the words from one on, and how far they are."""
        word = self.words[start]
        if word in _NO_VALUE:
            return
        for first, entries in self.vocabulary.by_first.items():
            if distance(word, first) is None:
                continue
            for entry in entries:
                far = self.apart(start, entry.words)
                if far is not None:
                    yield entry, far

    def object_length(self, start: int) -> int:
        """Return how many words from one on are the name of an object, and no value."""
        if self.matches[start]:
            return 0
        length = 0
        for name in self.vocabulary.objects:
            if len(name) <= LONGEST_NAME and self.apart(start, name) == 0:
                length = max(length, len(name))
        is_word = length == 1 and self.words[start] == "can"
        if is_word and self.word(start + 1) not in {*JOINS, *WEAK, "that"}:
            return 0  # the verb
        return length

    def following(self, state: ReadingState) -> States:
        """Yield the states behind what may be read next."""
        start = state.position
        word = self.words[start]
        if self.object_lengths[start] > 1:
            return
        if _COMPARED.fullmatch(word):
            yield from self.numbered(state, word)
            return
        if word == "one" and self.vocabulary.noun(self.word(start + 1), counted=True):
            yield state.then(number="= 1", weak=())
        if state.noun and state.outer is None:  # "more than two parts that ..."
            for closed in state.closed():
                cost = closed.cost + INFLECTED
                yield from self.following(replace(closed, cost=cost))
        yield from self.values(state)
        for entry, far in self.matches[start]:
            if len(entry.words) > 1 and far <= INFLECTED:
                return  # the "living room" is no room where something lives
        yield from self.superlatives(state, word)
        if word in JOINS:
            yield from self.joins(state, word)
        elif word in WORDS["negations"]:
            yield from self.negations(state, word)
        elif not self.object_lengths[start]:
            yield from self.cues(state, word)

    def joins(self, state: ReadingState, word: str) -> States:
        """Yield the states behind "and", "or", "but" or a comma."""
        said = state.strong or state.outer
        if word == "but" and (said or self.words[state.position - 1] in WORDS["any"]):
            # "any colour but blue", "made of anything but metal"
            yield state.then(strong=said, outer=None, negated=True, noun="")
            return
        for closed in state.closed():
            join = JOINS[word]
            if join == "," and closed.join:
                join = closed.join
            if closed.done or not closed.join:
                yield closed.then(join=join, negated=None)

    def negations(self, state: ReadingState, word: str) -> States:
        """Yield the state behind "not", "without" or the like."""
        if state.outer is not None or state.number:
            return
        weak = state.weak
        if word.startswith(("without", "lack")):
            weak += ("with",)
        join = state.join
        if word == "nor":
            join = join or "and"
        yield state.then(weak=weak, join=join, noun="", negated=not state.negated)

    def cues(self, state: ReadingState, word: str) -> States:
        """Yield the states behind a word that says a relation, or changes nothing."""
        start = state.position
        last = "" if state.join else state.last
        said = self.vocabulary.said(word)
        if said:
            both = said & (state.strong or said)
            if both:
                is_counted = state.number != "" or self.words[start - 1] == "no"
                noun = self.vocabulary.noun(word, is_counted)
                yield state.then(strong=both, noun=noun)
            is_location = word == "used" and self.word(start + 1) in ("in", "at", "on")
            if state.is_unsaid and (last in said or is_location):
                yield state.then()  # "round shape", "red in colour", "used in the kitchen"
        if word in WEAK:
            yield state.then(weak=(*state.weak, word))
            if last and (
                word != "with" or self.vocabulary.family(last) is FAMILIES["use"]
            ):
                yield state.then(cost=state.cost + 0.01)  # "to drink from"
            if start and self.words[start - 1] in WORDS["requests"] and not state.done:
                yield state.then()  # "look for", "want to"
        if word in WORDS["things"]:
            yield state.behind_thing()
        elif word in _IGNORED or word in WORDS["able"]:
            if word in WORDS["able"] and not state.weak:
                yield state.then(weak=("to",))
            yield state.then()
        if word in WORDS["requests"] and state.is_unsaid and not state.done:
            yield state.then()

    def values(self, state: ReadingState) -> States:
        """Yield the states behind the values that stand at a place."""
        if state.number or state.best:
            return
        matches = self.matches[state.position]
        longest = max((len(entry.words) for entry, _ in matches), default=0)
        for entry, far in matches:
            if len(entry.words) < longest:
                continue
            is_verb = far == INFLECTED and entry.words[-1].endswith("ing")
            if is_verb and not self.is_purpose(state):
                continue
            if far and state.weak[-1:] == ("for",) and self.has_exact(state, entry):
                continue  # "for water" is not to water, though "water" is its verb
            cost = self.fits(entry, state)
            if cost is not None:
                yield state.added(
                    entry.text, entry.relation, longest, far + cost, state.is_bare
                )

    def is_purpose(self, state: ReadingState) -> bool:
        """Return whether a value that is a verb may be meant: not by "light" and "stored"."""
        word = self.words[state.position]
        before = self.words[state.position - 1] if state.position else ""
        if word.endswith("s") and before in ("that", "which", "what"):
            return True
        is_said = state.strong is not None or "for" in state.weak or "to" in state.weak
        continues = bool(state.join and state.done) and "ing" in state.done[-1].text
        return (is_said or continues) and not word.endswith("ed")

    def has_exact(self, state: ReadingState, entry: Entry) -> bool:
        """Return whether the next words are exactly another value than that of an entry."""
        for other, far in self.matches[state.position]:
            if far == 0 and not other.inner and other.text != entry.text:
                return True
        return False

    def fits(self, entry: Entry, state: ReadingState) -> float | None:
        """Return what it costs to read a value by the words before it, None if it cannot be."""
        relation = entry.relation
        strong = state.strong or ()
        if state.outer is not None:  # what a thing is, that was said before it
            if not entry.inner or relation not in state.outer:
                return None
            if entry.inner in strong or self.is_allowed(entry.inner, state):
                return 0.0
            return None
        cost = 0.0
        if entry.inner:
            if self.vocabulary.family(entry.inner) is not FAMILIES["type"]:
                return None
            cost = 0.5
        if strong and relation not in strong:
            return None
        if state.weak and not self.is_allowed(relation, state):
            # "made by" is not "made of"
            prepositions = WEAK.intersection(self.vocabulary.words[relation][1:])
            return None if prepositions or not strong else cost
        if not state.is_unsaid:
            return cost
        family = self.vocabulary.family(relation)
        continues = state.join != "" and state.done != ()
        if continues and relation == state.last:
            return cost
        if entry.inner or family.relations == "":
            return None
        if family.describes and not continues:
            return 0.0
        if family.describes or not state.done:
            return 0.05
        return None

    def is_allowed(self, relation: str, state: ReadingState) -> bool:
        """Return whether one of the last prepositions can stand before a value of a relation."""
        return not self.vocabulary.prepositions(relation).isdisjoint(state.weak)

    def numbered(self, state: ReadingState, word: str) -> States:
        """Yield the states behind a number: compared with what was said, or of what follows."""
        sign, digits = _COMPARED.findall(word)[0]
        number = f"{sign or '='} {digits}"
        length = 1 + (self.word(state.position + 1) in WORDS["money"])
        for relation in sorted(state.strong or ()):
            if relation in self.vocabulary.numbers:
                yield state.added(f"{relation} {number}", relation, length)
        if state.noun:
            yield state.then(number=number)
        elif state.strong is None and digits.isdecimal():
            yield state.then(number=number, weak=())

    def superlatives(self, state: ReadingState, word: str) -> States:
        """Yield the states behind "most parts", "the cheapest", "lowest price", "cheaper than"."""
        end = state.position + 1
        best = _BEST.get(word)
        if best:
            yield state.then(best=best, weak=())
            for relation in sorted(self.vocabulary.said(self.word(end))):
                if relation in self.vocabulary.numbers:
                    yield state.added(relation, relation, length=2, best=best)
        adjective = word
        if word in ("most", "least", "more", "less"):
            adjective = self.word(end)
            end += 1
        relation, sign = self.vocabulary.measured(adjective)
        if not relation:
            return
        if word in ("least", "less"):
            sign = "<" if sign == ">" else ">"
        length = end - state.position
        number = self.word(end + 1)
        if word.endswith("est") or word in ("most", "least"):
            yield state.added(relation, relation, length, best=sign)
        elif self.word(end) == "than" and re.fullmatch(NUMBER, number):
            length += 2 + (self.word(end + 2) in WORDS["money"])
            yield state.added(f"{relation} {sign} {number}", relation, length)


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
    superlative = best[0]
    is_or = any(condition.join == "or" for condition in conditions)
    if len(best) > 1 or superlative.negated or is_or:
        raise reader.refused("of superlatives it may hold one, which only 'and' joins")
    relation = superlative.relation
    if superlative.text.startswith("count "):
        numbers = vocabulary.counts[relation]
    else:
        numbers = vocabulary.numbers[relation]
    among = set(vocabulary.heads)
    if rest:
        among = holders(joined(rest))
    values = [number for head, number in numbers.items() if head in among]
    if not values:
        raise reader.refused(f"no object that it is about has a number of {relation}")
    extreme = max(values) if superlative.best == ">" else min(values)
    return joined([*rest, ReadCondition(f"{superlative.text} = {extreme:g}")])
