"""Grammar of questions in plain English: all readings of some words, and the nearest of them."""

import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import chain, compress, count
from operator import attrgetter

from knowarm.asking.lexicon import (
    BESIDE,
    EXTREMES,
    FAMILIES,
    INFLECTED,
    JOINS,
    NUMBER,
    WEAK,
    WORDS,
    is_adjective,
    near,
)
from knowarm.asking.meanings import IGNORED, NO_VALUE, Match, Meanings
from knowarm.asking.quotes import quoted
from knowarm.asking.readings import ReadCondition, ReadingState, joined
from knowarm.asking.relations import IS, NO_RELATION, PLACES, Relation
from knowarm.asking.vocabulary import Entry, Vocabulary
from knowarm.errors import UserError
from knowarm.questions import COLOUR_RELATION

States = Iterator[ReadingState]
Cost = float | None
"""Cost of a reading; None if the words cannot be read so."""

_NO_HINT = NO_VALUE.union(WORDS.requests, WORDS.able)
_COMPARED = re.compile(rf"((?:[<>!]=?|=)?)({NUMBER})")
_BEST = dict.fromkeys(WORDS.largest, ">") | dict.fromkeys(WORDS.smallest, "<")
MOST_WORDS = 60
MOST_READINGS = 2_000
MOST_LEFT_OUT = 6
"""Most words of a question, steps of its readings, and words that are left out of one."""
PURPOSE = {"to", "for"}
"""Prepositions before verbs."""
LEFT_OUT = 0.4
OTHER_THAN_NAME = 0.3
"""Costs of a word that is left out, and of a value where a name has the same words."""


class Reader:
    """Enumerates the readings of words: each rule yields what a state may become.

    Args:
        text: the question, for errors.
        words: its words, or some of them.
        vocabulary: what can be asked.

    Raises:
        UserError: it has too many words.
    """

    def __init__(self, text: str, words: Sequence[str], vocabulary: Vocabulary) -> None:
        self.text = text
        self.vocabulary = vocabulary
        self.words = Meanings(words, vocabulary)
        if not 0 < len(words) <= MOST_WORDS:
            raise self.refused(
                f"it has {len(words)} words, allowed are 1 to {MOST_WORDS}"
            )

    def refused(self, why: str) -> UserError:
        """Return the error of a question that is not understood, with the nearest conditions."""
        values = [word for word in self.words.words if word not in _NO_HINT]
        nearest = self.vocabulary.nearest(values)
        return UserError(
            f"The question {self.text!r} is not understood: {why}. {nearest}"
        )

    def best(self) -> ReadingState:
        """Return the end of the nearest reading."""
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
        return nearest

    def reason(self, furthest: int) -> str:
        """Return why there is no reading, all of which end at a word."""
        if furthest == len(self.words):
            return "its parts do not fit together"
        word = self.words[furthest]
        if word in BESIDE:
            return f"{BESIDE[word]!r} needs an object that can be asked for"
        return f"{word!r} fits nothing here"

    def following(self, state: ReadingState) -> States:
        """Yield the states behind what may be read next."""
        word = self.words[state.position]
        if _COMPARED.fullmatch(word):
            yield from self.numbered(state, word)
            return
        after = self.words[state.position + 1]
        if word == "one" and self.vocabulary.noun(after, counted=True):
            yield state.then(number="= 1", weak=())
        yield from self.values(state)
        for match in self.words.matches[state.position]:
            is_one = match.length > 1 and not match.entry.inner
            if is_one and match.far <= INFLECTED:
                return  # the "living room" is no room where something lives
        yield from self.superlatives(state, word)
        if word in EXTREMES and state.is_unsaid:
            relation = PLACES[EXTREMES[word]]
            yield state.added(ReadCondition(relation.name, relation), 1)
        if word in BESIDE and state.is_unsaid:
            yield from self.beside(state, BESIDE[word])
        if word in JOINS:
            yield from self.joins(state, word)
        elif word in WORDS.negations:
            yield from self.negations(state, word)
        else:
            yield from self.cues(state, word)
            yield from self.left_out(state, word)

    def beside(self, state: ReadingState, relation: str) -> States:
        """Yield the states behind "left of the red mug", whose last words are a question, too."""
        start = state.position + 1
        name = state.name.removeprefix("is ")
        cost = 0.0
        for end in range(start + 1, len(self.words) + 1):
            if self.words[end] not in JOINS:
                continue
            with suppress(UserError):
                words = self.words.words[start:end]
                if name.isalpha():  # "the mug left of the red one"
                    words = [name if word == "one" else word for word in words]
                other = Reader(self.text, words, self.vocabulary).best()
                last = other.done[-1]
                is_place = last.is_bare and last.relation.family is FAMILIES["location"]
                is_place &= not last.is_whole  # "next to the sofa" is not what is on it
                if not is_place and not any(map(attrgetter("best"), other.done)):
                    left_out = [start + position for position in other.left_out]
                    reached = replace(state, left_out=(*state.left_out, *left_out))
                    text = f"{relation} ({joined(other.done)})"
                    condition = ReadCondition(text, PLACES[relation])
                    length = 1 + other.position
                    yield reached.added(condition, length, cost + other.cost)
            if JOINS[self.words[end]] != "or":
                cost += INFLECTED  # it ends at the first "and"
            elif self.words[end + 1] in (*BESIDE, *EXTREMES):
                return

    def left_out(self, state: ReadingState, word: str) -> States:
        """Yield the states behind a word that is left out: what is done with, and a kind."""
        if len(state.left_out) >= MOST_LEFT_OUT:
            return
        if not word.isalpha():
            return
        start = state.position
        after = self.words[start + 1]
        left_out = (*state.left_out, start)
        cost = state.cost + LEFT_OUT
        if not state.takes_object:
            if self.words.is_kind(start):
                yield replace(state.behind_thing(), left_out=left_out, cost=cost)
            return
        if word in WORDS.particles:
            yield state.then(cost=state.cost + 0.01, takes_object=True)
            return
        is_left_out = word in WORDS.places  # "to read in bed"
        if word == "with":
            is_left_out = after not in WORDS.determiners | WORDS.things
        elif not is_left_out and word not in NO_VALUE:
            is_word = not self.vocabulary.said(word) and word not in WORDS.looks
            is_left_out = is_word or self.words.is_determined(start)
        if is_left_out:
            yield state.then(cost=cost, left_out=left_out, takes_object=True)

    def joins(self, state: ReadingState, word: str) -> States:
        """Yield the states behind "and", "or", "but" or a comma."""
        said = state.strong or state.outer
        is_any = not WORDS.any.isdisjoint(self.words.words[: state.position])
        if word == "but" and said and is_any:
            # "any colour but blue", "made of anything but metal"
            yield state.then(strong=said, outer=None, negated=True, noun=None)
            if not state.noun:
                return
        # "everything made of metal but the pan"
        negated = None
        is_not = self.words[state.position + 1] in WORDS.negations
        if word == "but" and is_any and not is_not:
            negated = True
        for closed in state.closed():
            join = JOINS[word]
            if join == "," and closed.join:
                join = closed.join
            if closed.done or not closed.join:
                yield closed.then(join=join, negated=negated)

    def negations(self, state: ReadingState, word: str) -> States:
        """Yield the state behind "not", "without" or the like."""
        if word == "nor":
            for closed in state.closed():
                if closed.done and not closed.negated:
                    yield closed.then(join=closed.join or "and", negated=True)
            return
        if state.outer is not None:
            return
        if state.number:
            return
        weak = state.weak
        if word.startswith(("without", "lack")):
            weak += ("with",)
        yield state.then(weak=weak, noun=None, negated=not state.negated)

    def cues(self, state: ReadingState, word: str) -> States:
        """Yield the states behind a word that says a relation, or changes nothing."""
        start = state.position
        last = state.last
        if state.join:
            last = NO_RELATION
        before = self.words[start - 1]
        after = self.words[start + 1]
        said = self.vocabulary.said(word)
        is_request = word in WORDS.requests and after in ("me", "us")
        if said and not is_request:
            both = said & (state.strong or said)
            if both:
                is_counted = state.number != "" or before == "no"
                noun = self.vocabulary.noun(word, is_counted)
                weak = state.weak
                if noun:
                    weak = ()
                cost = state.cost
                if word in BESIDE:  # rather what the image shows than `nextTo`
                    cost += OTHER_THAN_NAME
                yield state.then(strong=both, noun=noun, weak=weak, cost=cost)
            is_location = word == "used" and after in WORDS.used_at
            if state.is_unsaid and (last in said or is_location):
                yield state.then()  # "round shape", "red in colour", "used in the kitchen"
        for relation in state.strong or ():
            is_own = near(word, relation.words, INFLECTED) and word not in WEAK
            if is_own and not said:
                yield state.then()  # "avoids contact with"
        if word == "=" and state.strong is not None:  # "material = wood"
            yield state.then()
        if word in WEAK:
            yield state.then(weak=(*state.weak, word))
            is_counted = bool(state.done) and state.done[-1].text.startswith("count ")
            is_behind = word not in ("with", "of") and not is_counted
            if last.name and (is_behind or last.family.takes_object):
                yield state.then(cost=state.cost + 0.01)  # "to drink from"
            if before in WORDS.requests and not state.done:
                yield state.then()  # "look for", "want to"
        if word in WORDS.things:
            name = state.other_name
            is_other = word in ("one", "ones") and state.is_bare
            if name and is_other and not state.join:
                condition = ReadCondition(name, IS, name=name, is_bare=True)
                yield from state.named(condition, 1, 0.0)
                return
            if state.is_phrase_clear:
                yield state.behind_thing()
            if state.noun:  # "not carrying anything"
                yield state.then()
        elif word == "whose" and not self.vocabulary.said(after):
            return  # "whose cover is red" is not red
        elif word in WORDS.nouns and self.words.matches[start]:
            return
        elif word in IGNORED or word in WORDS.able:
            if word in WORDS.able and not state.weak:
                yield state.then(weak=("to",))
            takes_object = state.takes_object and word in WORDS.determiners
            yield state.then(takes_object=takes_object)
        elif word in WORDS.requests and state.is_unsaid and not state.done:
            yield state.then()

    def values(self, state: ReadingState) -> States:
        """Yield the states behind the values that stand at a place."""
        if state.number:
            return
        if state.best:
            return
        position = state.position
        matches = self.words.matches[position]
        longest = max(map(attrgetter("length"), matches), default=0)
        matches = [match for match in matches if match.length == longest]
        has_name = IS in map(attrgetter("entry.relation"), matches)
        for match in matches:
            entry = match.entry
            is_name = entry.relation is IS
            if is_name and (not state.is_bare or state.takes_object):
                continue
            cost: Cost = match.far
            if not is_name:
                cost = self.cost(state, match)
            if cost is None:
                continue
            condition = ReadCondition(
                entry.text,
                entry.relation,
                is_bare=state.is_bare,
                is_determined=self.words.is_determined(position),
                reach=self.words.reach(position),
            )
            if is_name:
                named = replace(condition, name=entry.text)
                yield from state.named(named, longest, cost)
                continue
            if has_name and state.is_bare:  # "a brush" is one
                cost += OTHER_THAN_NAME
            is_verb = entry.relation.family.takes_object or entry.role == "verb"
            is_verb &= not state.is_bare or self.words.is_verb(position)
            added = state.added(condition, longest, cost)
            yield replace(added, takes_object=is_verb)

    def cost(self, state: ReadingState, match: Match) -> Cost:
        """Return what it costs to read words as a value, None if they cannot be."""
        if self.is_kept_out(state, match):
            return None
        cost = self.fits(match.entry, state)
        if cost is None:
            return None
        if match.entry in self.vocabulary.elsewhere:
            cost += INFLECTED
        if match.entry.relation.is_narrow:
            cost += INFLECTED
        return cost + match.far

    def is_kept_out(self, state: ReadingState, match: Match) -> bool:
        """Return whether words may not be a value, though they are near to it."""
        entry = match.entry
        word = self.words[state.position]
        is_doing = match.far > 0 and word.endswith("ing")
        if is_doing and entry.relation.family is FAMILIES["type"]:
            return True  # "drinking" is no drink
        if match.far == INFLECTED and entry.words[-1].endswith("ing"):
            # Not by "light" and "stored", but by "for light", "that lights", "to cook or light"
            is_said = state.strong is not None or not PURPOSE.isdisjoint(state.weak)
            is_said |= bool(state.join and state.done) and "ing" in state.done[-1].text
            if word.endswith("ed"):
                return True
            if not (is_said or self.words.is_verb(state.position)):
                return True
        if state.is_bare and self.words.is_verb(state.position):
            # "that waters" does not contain water
            is_verb = entry.relation.family.takes_object or entry.role == "verb"
            if not is_verb:
                return True
        if state.takes_object and state.is_bare and not state.join:
            # "to cut wood" is not made of wood
            return entry.relation.name != COLOUR_RELATION
        # "for water" is not to water, though "water" is its verb
        is_for = match.far > 0 and state.weak[-1:] == ("for",)
        return is_for and self.words.has_exact(state.position, entry)

    def fits(self, entry: Entry, state: ReadingState) -> Cost:
        """Return what it costs to read a value by the words before it, None if it cannot be."""
        relation = entry.relation
        strong = state.strong or ()
        # "for children" is not unsafe for them
        if relation.turning is not None and relation not in strong:
            return None
        if state.outer is not None:  # what a thing is, that was said before it
            if entry.inner is None:
                return None
            if relation not in state.outer:
                return None
            if entry.inner in strong:
                return 0.0
            if entry.inner.prepositions.isdisjoint(state.weak):
                return None
            return 0.0
        if strong and relation not in strong:
            return None
        is_listed = state.join and state.is_unsaid and relation == state.last
        if entry.role:
            if not is_listed and not self.is_said_by_role(entry, state):
                return None
            if entry.role in ("head", "kind"):
                return OTHER_THAN_NAME
            return 0.0
        cost = 0.0
        if entry.inner:
            if entry.inner.family is not FAMILIES["type"]:
                return None
            cost = 0.5
        if state.weak and relation.prepositions.isdisjoint(state.weak):
            prepositions = WEAK.intersection(relation.words[1:])
            if state.weak[-1:] == ("by",):  # "grasped by the handle"
                prepositions -= {"at"}
            if not strong:
                return None
            # "made by" is not "made of"
            if prepositions and prepositions.isdisjoint(state.weak):
                return None
            return cost
        is_other = set(relation.words).isdisjoint(state.weak[-1:])
        if state.weak and is_other and WEAK.issuperset(relation.words):
            cost += INFLECTED  # "on the stove" of what is `on` or `in` it
        if is_listed or not state.is_unsaid:
            return cost
        family = relation.family
        if entry in self.vocabulary.elsewhere and family is FAMILIES["relation"]:
            return None
        if entry.inner:
            return None
        if family.relations == "" and not is_adjective(entry.words[-1]):
            return None
        if family.describes:
            if state.join and state.done:
                return 0.05
            return 0.0
        if family.relations == "" or not state.done:
            return 0.05
        return None

    def is_said_by_role(self, entry: Entry, state: ReadingState) -> bool:
        """Return whether words say CAN_OPEN, as "to open", or HAS_SWITCH, as "with a switch"."""
        if entry.role == "kind":
            return state.is_bare
        prepositions = PURPOSE
        if entry.role in ("part", "head"):
            prepositions = set(FAMILIES["part"].weak)
        before = self.words[state.position - 1]
        is_verb = entry.role == "verb" and entry.words[-1] in WORDS.intransitive
        if is_verb and before in WORDS.subjects:
            return True
        return not prepositions.isdisjoint(state.weak)

    def numbered(self, state: ReadingState, word: str) -> States:
        """Yield the states behind a number: compared with what was said, or of what follows."""
        sign, digits = _COMPARED.findall(word)[0]
        number = f"{sign or '='} {digits}"
        for relation in sorted(state.strong or (), key=attrgetter("name")):
            if relation.numbers:
                yield self.with_number(state, relation, number, 1)
        last = state.last
        if state.is_bare and state.join and last.numbers:  # "price >= 3 and <= 6"
            yield self.with_number(state, last, number, 1)
        if state.noun:
            yield state.then(number=number)
        elif state.strong is None and digits.isdecimal():
            yield state.then(number=number, weak=())

    def with_number(
        self, state: ReadingState, relation: Relation, number: str, length: int
    ) -> ReadingState:
        """Return the state behind a comparison of a relation with a number, such as "< 6"."""
        text = f"{quoted(relation.name)} {number}"
        return state.added(ReadCondition(text, relation), length)

    def superlatives(self, state: ReadingState, word: str) -> States:
        """Yield the states behind "most parts", "the cheapest", "lowest price", "cheaper than"."""
        end = state.position + 1
        best = _BEST.get(word)
        if best:
            yield state.then(best=best, weak=())
            relations = self.vocabulary.said(self.words[end])
            for said in sorted(relations, key=attrgetter("name")):
                if said.numbers:
                    text = quoted(said.name)
                    yield state.added(ReadCondition(text, said, best=best), 2)
        adjective = word
        if word in WORDS.degrees:
            adjective = self.words[end]
            end += 1
        relation, sign = self.vocabulary.measured(adjective)
        if relation is None:
            return
        if word in ("least", "less"):
            sign = "<" if sign == ">" else ">"
        length = end - state.position
        number = self.words[end + 1]
        if word.endswith("est") or word in ("most", "least"):
            condition = ReadCondition(quoted(relation.name), relation, best=sign)
            yield state.added(condition, length)
        elif self.words[end] == "than" and re.fullmatch(NUMBER, number):
            yield self.with_number(state, relation, f"{sign} {number}", length + 2)
