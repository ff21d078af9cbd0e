"""Questions in plain English, read as those of `expressions` by the vocabulary of a graph.

    something to drink from that is not red  ->  usedFor drinking and not hasColor red

Every word is accounted for: as a value, as a cue for a relation ("made of"), as one that joins or
negates, or as one of a few that change nothing. All readings are enumerated, and the nearest one
counts if it is the only one. Anything else is refused, with the nearest conditions of the graph.
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

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

_THINGS, _NEGATIONS, _REQUESTS = ({*WORDS[each]} for each in ("things", "negations", "requests"))
_ABLE, _IGNORED = {*WORDS["able"]}, _THINGS | {*WORDS["ignored"]}
_NO_VALUE = _IGNORED | _NEGATIONS | WEAK | {*JOINS}
_COMPARED = re.compile(rf"((?:[<>!]=?|=)?)({NUMBER})")
MOST_WORDS, MOST_READINGS = 60, 2_000
"""Most words of a question, and most steps of its readings."""


@dataclass(frozen=True)
class _State:
    """What one reading has read so far."""

    done: tuple[ReadCondition, ...] = ()
    cost: float = 0.0
    strong: frozenset[str] | None = None  # The relations that are said; not used yet
    outer: frozenset[str] | None = None  # The same before a noun: "used for something ..."
    weak: tuple[str, ...] = ()  # Prepositions since the last condition
    noun: str = ""  # The relation of a noun that is counted
    number: str = ""
    best: str = ""
    join: str = ""
    negated: bool | None = None
    is_new: bool = False

    @property
    def is_end(self) -> bool:
        """Whether the question may end here."""
        is_open = self.is_new or self.negated is not None or self.join not in ("", ",")
        return bool(self.done) and not is_open


class _Reader:
    """Enumerates the readings of a question."""

    def __init__(self, text: str, vocabulary: Vocabulary) -> None:
        self.text, self.vocabulary = text, vocabulary
        self.words = tokens(text)
        if not 0 < len(self.words) <= MOST_WORDS:
            raise self.refused(f"it has {len(self.words)} words, allowed are 1 to {MOST_WORDS}")
        self.found = [[*self.matches(place)] for place in range(len(self.words))]

    def refused(self, why: str) -> UserError:
        """Return the error of a question that is not understood, with the nearest conditions."""
        near = self.vocabulary.nearest([word for word in self.words if word not in _NO_VALUE])
        return UserError(f"The question {self.text!r} is not understood: {why}. {near}")

    def best(self) -> list[ReadCondition]:
        """Return the conditions of the nearest reading."""
        if self.words[0] in WORDS["unanswered"]:
            raise self.refused("only questions for an object are answered")
        reached: list[dict[_State, None]] = [{_State(): None}, *({} for _ in self.words)]
        for place, states in enumerate(reached[:-1]):
            for state in states:
                for length, following in self.following(place, state):
                    reached[place + length][following] = None
            if len(states) > MOST_READINGS:
                raise self.refused("it can be read in too many ways")
        ends = [end for state in reached[-1] for end in self.closed(state) if end.is_end]
        readings: dict[str, tuple[float, list[ReadCondition]]] = {}
        for end in sorted(ends, key=lambda each: each.cost):
            readings.setdefault(joined(end.done), (end.cost, [*end.done]))
        if not readings:
            raise self.refused(self.reason(max(i for i, states in enumerate(reached) if states)))
        least, conditions = next(iter(readings.values()))
        alike = [text for text, (cost, _) in readings.items() if cost < least + INFLECTED / 2]
        if len(alike) > 1:
            raise self.refused(f"it may mean {', or '.join(alike[:3])}")
        if not alike[0]:
            first, second, *_, last = [f"{'not ' * c.negated}{c.text}" for c in conditions]
            remedy = f"write it with brackets, as ({first} or {second}) and {last}"
            raise self.refused(f"'and' and 'or' can be joined in several ways; {remedy}")
        return conditions

    def reason(self, furthest: int) -> str:
        """Return why there is no reading, all of which end at a word."""
        places = [(i, length) for length in (3, 2, 1) for i in range(len(self.words))]
        for start, length in filter(lambda each: self.is_object(*each), places):
            name = " ".join(self.words[start : start + length])
            return f"{name!r} names an object, and a question describes it instead"
        if furthest == len(self.words):
            return "its parts do not fit together"
        return f"{self.words[furthest]!r} fits nothing here"

    def following(self, place: int, state: _State) -> Iterator[tuple[int, _State]]:
        """Yield what may be read next: a number of words, and the state behind them."""
        word, vocabulary = self.words[place], self.vocabulary
        if any(self.is_object(place, length) for length in (3, 2)):
            return
        if _COMPARED.fullmatch(word):
            yield from self.numbered(place, state)
            return
        if word == "one" and vocabulary.noun(self.after(place), counted=True):
            yield 1, replace(state, number="1", weak=())
        if state.noun and state.outer is None:  # "more than two parts that ..."
            for closed in self.closed(state):
                yield from self.following(place, replace(closed, cost=closed.cost + INFLECTED))
        yield from self.values(place, state)
        if any(len(each.words) > 1 and far <= INFLECTED for each, far in self.found[place]):
            return  # the "living room" is no room where something lives
        yield from self.superlatives(place, state)
        if word in JOINS:
            join = JOINS[word]
            said = state.strong or state.outer
            if word == "but" and (said or self.words[place - 1] in WORDS["any"]):
                yield 1, replace(state, strong=said, outer=None, negated=True, noun="")
                return  # "any colour but blue", "made of anything but metal"
            for closed in self.closed(state):
                if closed.done or not closed.join:
                    join = closed.join if join == "," and closed.join else join
                    yield 1, replace(closed, join=join, negated=None)
        elif word in _NEGATIONS:
            weak = ("with",) if word.startswith(("without", "lack")) else ()
            join = state.join or ("and" if word == "nor" else "")
            if state.outer is None and not state.number:
                after = replace(state, weak=state.weak + weak, join=join, noun="")
                yield 1, replace(after, negated=not state.negated)
        elif not self.is_object(place, 1):
            yield from self.cues(place, state)

    def cues(self, place: int, state: _State) -> Iterator[tuple[int, _State]]:
        """Yield the state behind a word that says a relation, or changes nothing."""
        word, vocabulary = self.words[place], self.vocabulary
        last = state.done[-1].relation if state.done and not state.join else ""
        if said := vocabulary.said(word):
            both = said if state.strong is None else said & state.strong
            is_counted = bool(state.number) or self.words[place - 1] == "no"
            if both:
                yield 1, replace(state, strong=both, noun=vocabulary.noun(word, is_counted))
            is_place = word == "used" and self.after(place) in ("in", "at", "on")
            if state.strong is None and not state.weak and (last in said or is_place):
                yield 1, state  # "round shape", "red in colour", "used in the kitchen"
        if word in WEAK:
            yield 1, replace(state, weak=(*state.weak, word))
            if last and (word != "with" or FAMILIES["use"] is vocabulary.family(last)):
                yield 1, replace(state, cost=state.cost + 0.01)  # "to drink from"
            if place and self.words[place - 1] in _REQUESTS and not state.done:
                yield 1, state  # "look for", "want to"
        if word in _THINGS and state.strong is not None:
            yield 1, replace(state, outer=state.strong, strong=None, weak=(), noun="")
        elif word in _THINGS and (state.join or not state.done):
            weak = () if state.weak == ("of",) else state.weak  # "one of the objects"
            yield 1, replace(state, is_new=bool(state.join), weak=weak)
        elif word in _THINGS:
            whole = replace(state.done[-1], is_whole=True)
            yield 1, replace(state, done=(*state.done[:-1], whole))
        elif word in _ABLE and not state.weak:
            yield 1, replace(state, weak=("to",))
            yield 1, state
        elif word in _IGNORED | _ABLE:
            yield 1, state
        if word in _REQUESTS and not (state.done or state.strong or state.weak):
            yield 1, state

    def is_object(self, place: int, length: int) -> bool:
        """Return whether words are the name of an object, and no value."""
        words = self.words[place : place + length]
        is_verb = words == ["can"] and self.after(place) not in {*JOINS, *WEAK, "that"}
        return not (is_verb or self.found[place]) and any(
            all(near(word, each, 0) for word, each in zip(words, name, strict=True))
            for name in self.vocabulary.objects
            if len(name) == len(words) == length
        )

    def after(self, place: int) -> str:
        """Return the word behind a place, or a comma at the end."""
        return self.words[place + 1] if place + 1 < len(self.words) else ","

    def is_purpose(self, place: int, state: _State) -> bool:
        """Return whether a value that is a verb may be meant: not by "light" and "stored"."""
        word, before = self.words[place], self.words[place - 1] if place else ""
        is_said = state.strong is not None or bool({*state.weak} & {"for", "to"})
        is_said |= bool(state.join and state.done and "ing" in state.done[-1].text)
        does = word.endswith("s") and before in ("that", "which", "what")
        return does or (is_said and not word.endswith("ed"))

    def matches(self, place: int) -> Iterator[tuple[Entry, float]]:
        """Yield the values that may be meant by the words at a place, and how far they are."""
        for first, entries in self.vocabulary.by_first.items():
            if self.words[place] in _NO_VALUE or distance(self.words[place], first) is None:
                continue
            for entry in entries:
                words = self.words[place : place + len(entry.words)]
                if len(words) == len(entry.words):
                    far = [distance(*pair) for pair in zip(words, entry.words, strict=True)]
                    if None not in far:
                        yield entry, sum(each for each in far if each is not None)

    def values(self, place: int, state: _State) -> Iterator[tuple[int, _State]]:
        """Yield the states behind the values that stand at a place."""
        found = [] if state.number or state.best else self.found[place]
        longest = max((len(entry.words) for entry, _ in found), default=0)
        for entry, cost in found:
            if len(entry.words) < longest:
                continue
            is_other = any(not far and not e.inner for e, far in found if e.text != entry.text)
            is_verb = cost == INFLECTED and entry.words[-1].endswith("ing")
            if is_verb and not self.is_purpose(place, state):
                continue
            if cost and is_other and state.weak[-1:] == ("for",):
                continue  # "for water" is not to water, though "water" is its verb
            if (more := self.fits(entry, state)) is not None:
                bare = state.strong is None and not state.weak and state.outer is None
                condition = ReadCondition(entry.text, entry.relation, is_bare=bare)
                yield longest, self.added(state, condition, cost + more)

    def fits(self, entry: Entry, state: _State) -> float | None:
        """Return what it costs to read a value by the words before it, None if it cannot be."""
        vocabulary, relation = self.vocabulary, entry.relation
        if state.outer is not None:
            said = state.strong is not None and entry.inner in state.strong
            said |= any(entry.inner and vocabulary.allows(w, entry.inner) for w in state.weak)
            return 0.0 if entry.inner and said and relation in state.outer else None
        if entry.inner and vocabulary.family(entry.inner) is not FAMILIES["type"]:
            return None
        more = 0.5 if entry.inner else 0.0
        allowed = any(vocabulary.allows(word, relation) for word in state.weak)
        if state.strong is not None:
            own = WEAK & {*vocabulary.words[relation][1:]}  # "made by" is not "made of"
            is_other = own and state.weak and not allowed
            return more if relation in state.strong and not is_other else None
        if state.weak:
            return more if allowed else None
        last = state.done[-1].relation if state.done and state.join else ""
        if entry.inner or vocabulary.family(relation).relations == "":
            return more if relation == last else None
        if relation == last or vocabulary.family(relation).describes:
            return 0.0 if relation == last or not last else 0.05
        return None if state.done else 0.05

    def added(self, state: _State, condition: ReadCondition, cost: float = 0.0) -> _State:
        """Return the state behind a condition."""
        join, inherits, negated = state.join or "and", False, state.negated
        if negated is None and state.done and state.join and not state.is_new:
            before = state.done[-1]
            same = before.relation == condition.relation or join == "or"
            is_open = before.negated and not before.is_whole  # "not the blue one, the red one"
            inherits = is_open and condition.is_bare and same and join != "but"
        whole = replace(
            condition,
            join=join,
            negated=inherits if negated is None else negated,
            inherits=inherits,
            is_new=state.is_new,
        )
        return _State(done=(*state.done, whole), cost=state.cost + cost)

    def closed(self, state: _State) -> Iterator[_State]:
        """Yield the state before "and", "or" and the end, if nothing is left open."""
        if state.noun and state.outer is None:
            sign, number = _COMPARED.findall(state.number or ("=0" if state.negated else ">=1"))[0]
            counted = f"count {state.noun}" + ("" if state.best else f" {sign or '='} {number}")
            bare = state if state.number else replace(state, negated=None)
            cost = 0.0 if state.number or state.best else 0.3
            yield self.added(bare, ReadCondition(counted, state.noun, best=state.best), cost)
        elif state.strong is None and state.outer is None and not (state.weak or state.number):
            yield state

    def numbered(self, place: int, state: _State) -> Iterator[tuple[int, _State]]:
        """Yield the states behind a number: compared with what was said, or of what follows."""
        sign, number = _COMPARED.findall(self.words[place])[0]
        length = 1 + (self.after(place) in WORDS["money"])
        for relation in sorted(state.strong or ()):
            if self.vocabulary.numbers(relation):
                text = f"{relation} {sign or '='} {number}"
                yield length, self.added(state, ReadCondition(text, relation))
        if state.noun:
            yield 1, replace(state, number=sign + number)
        elif state.strong is None and number.isdecimal():
            yield 1, replace(state, number=sign + number, weak=())

    def superlatives(self, place: int, state: _State) -> Iterator[tuple[int, _State]]:
        """Yield the states behind "most parts", "the cheapest", "lowest price", "cheaper than"."""
        word, *rest = (*self.words[place : place + 5], *[""] * 4)
        extreme = "max" if word in WORDS["largest"] else "min"
        if extreme == "max" or word in WORDS["smallest"]:
            yield 1, replace(state, best=extreme, weak=())
            for relation in filter(self.vocabulary.numbers, sorted(self.vocabulary.said(rest[0]))):
                yield 2, self.added(state, ReadCondition(relation, relation, best=extreme))
        is_two = word in ("most", "least", "more", "less")
        relation, sign = self.vocabulary.measured(rest.pop(0) if is_two else word)
        if relation and word in ("least", "less"):
            sign = {"<": ">", ">": "<"}[sign]
        if relation and (word.endswith("est") or word in ("most", "least")):
            extreme = "max" if sign == ">" else "min"
            condition = ReadCondition(relation, relation, best=extreme)
            yield 1 + is_two, self.added(state, condition)
        elif relation and rest[0] == "than" and re.fullmatch(NUMBER, rest[1]):
            length = 3 + is_two + (rest[2] in WORDS["money"])
            condition = ReadCondition(f"{relation} {sign} {rest[1]}", relation)
            yield length, self.added(state, condition)


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
    best, rest = [c for c in conditions if c.best], [c for c in conditions if not c.best]
    if not best:
        return joined(conditions)
    if len(best) > 1 or best[0].negated or any(c.join == "or" for c in conditions):
        raise reader.refused("of superlatives it may hold one, which only 'and' joins")
    among = holders(joined(rest)) if rest else {*vocabulary.heads}
    counted = best[0].text.startswith("count ")
    known = (vocabulary.counts if counted else vocabulary.numbers)(best[0].relation)
    values = [number for head, number in known.items() if head in among]
    if not values:
        raise reader.refused(f"no object that it is about has a number of {best[0].relation}")
    extreme = max(values) if best[0].best == "max" else min(values)
    return joined([*rest, ReadCondition(f"{best[0].text} = {extreme:g}")])
