"""Grammar of questions in plain English: all readings of some words, and the nearest of them."""

import re
from collections.abc import Collection, Iterator, Sequence
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
from knowarm.asking.vocabulary import IS, Entry, Vocabulary
from knowarm.errors import UserError
from knowarm.questions import COLOUR_RELATION

States = Iterator[ReadingState]

_NO_HINT = NO_VALUE.union(WORDS["requests"], WORDS["able"])
_COMPARED = re.compile(rf"((?:[<>!]=?|=)?)({NUMBER})")
_BEST = dict.fromkeys(WORDS["largest"], ">") | dict.fromkeys(WORDS["smallest"], "<")
MOST_WORDS = 60
MOST_READINGS = 2_000
MOST_LEFT_OUT = 6
"""Most words of a question, steps of its readings, and words that are left out of one."""
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
        if not 0 < len(words) <= MOST_WORDS:
            raise refusal(
                text,
                f"it has {len(words)} words, allowed are 1 to {MOST_WORDS}",
                words,
                vocabulary,
            )
        self.words = Meanings(words, vocabulary)

    def refused(self, why: str) -> UserError:
        """Return the error of a question that is not understood, with the nearest conditions."""
        return refusal(self.text, why, self.words.words, self.vocabulary)

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
        counted = self.vocabulary.noun(self.words[state.position + 1], counted=True)
        if word == "one" and counted:
            yield state.then(number="= 1", weak=())
        is_counted = state.noun and not self.vocabulary.is_verb(state.noun)
        if (is_counted or state.number) and state.outer is None:
            # "more than two parts that ..."
            for closed in state.closed():
                cost = closed.cost + INFLECTED
                yield from self.following(replace(closed, cost=cost))
        yield from self.values(state)
        for match in self.words.matches[state.position]:
            if match.length > 1 and match.far <= INFLECTED:
                return  # the "living room" is no room where something lives
        yield from self.superlatives(state, word)
        if word in EXTREMES and state.is_unsaid:
            yield state.added(ReadCondition(EXTREMES[word], EXTREMES[word]), 1)
        if word in BESIDE and state.is_unsaid:
            yield from self.beside(state, BESIDE[word])
        if word in JOINS:
            yield from self.joins(state, word)
        elif word in WORDS["negations"]:
            yield from self.negations(state, word)
        else:
            yield from self.cues(state, word)
            yield from self.left_out(state, word)

    def beside(self, state: ReadingState, relation: str) -> States:
        """Yield the states behind "left of the red mug", whose last words are a question, too."""
        start = state.position + 1
        name = state.name.removeprefix(f"{IS} ")
        cost = 0.0
        for end in range(start + 1, len(self.words) + 1):
            if self.words[end] not in JOINS:
                continue
            with suppress(UserError):
                words = self.words.words[start:end]
                if name.isalpha():  # "the mug left of the red one"
                    words = [name if word == "one" else word for word in words]
                other = Reader(self.text, words, self.vocabulary).best()
                if not any(map(attrgetter("best"), other.done)):
                    yield self.placed(state, relation, other, cost)
            if JOINS[self.words[end]] != "or":
                cost += INFLECTED  # it ends at the first "and"
            elif self.words[end + 1] in (*BESIDE, *EXTREMES):
                return

    def placed(
        self, state: ReadingState, relation: str, other: ReadingState, cost: float
    ) -> ReadingState:
        """Return the state behind a place beside what a reading of the next words is true of."""
        start = state.position + 1
        left_out = [start + position for position in other.left_out]
        beside = replace(state, left_out=(*state.left_out, *left_out))
        condition = ReadCondition(f"{relation} ({joined(other.done)})", relation)
        return beside.added(condition, 1 + other.position, cost + other.cost)

    def left_out(self, state: ReadingState, word: str) -> States:
        """Yield the states behind a word that is left out: what is done with, and a kind."""
        if len(state.left_out) >= MOST_LEFT_OUT or not word.isalpha():
            return
        start = state.position
        if state.takes_object and word in WORDS["particles"]:
            yield state.then(cost=state.cost + 0.01, takes_object=True)
        elif state.takes_object and self.words.is_place(start):
            yield state.without(LEFT_OUT)
        elif state.takes_object and word not in NO_VALUE:
            is_noun = self.words.is_determined(start)
            is_word = not self.vocabulary.said(word) and word not in WORDS["looks"]
            if is_noun or is_word:
                yield state.without(LEFT_OUT)
        if self.words.is_kind(start) and not state.takes_object:
            left_out = (*state.left_out, start)
            cost = state.cost + LEFT_OUT
            yield replace(state.behind_thing(), left_out=left_out, cost=cost)

    def joins(self, state: ReadingState, word: str) -> States:
        """Yield the states behind "and", "or", "but" or a comma."""
        said = state.strong or state.outer
        if word == "but" and (said or self.words[state.position - 1] in WORDS["any"]):
            # "any colour but blue", "made of anything but metal"
            yield state.then(strong=said, outer=None, negated=True, noun="")
            if not state.noun:
                return
        is_exception = word == "but" and self.is_exception(state.position)
        for closed in state.closed():
            join = JOINS[word]
            if join == "," and closed.join:
                join = closed.join
            if closed.done or not closed.join:
                negated = True if is_exception else None
                yield closed.then(join=join, negated=negated)

    def is_exception(self, position: int) -> bool:
        """Return whether a "but" means except: "everything made of metal but the pan"."""
        if self.words[position + 1] in WORDS["negations"]:
            return False
        is_any = not set(WORDS["any"]).isdisjoint(self.words.words[:position])
        is_behind_name = self.words.is_name(position - 1)
        return is_any and (is_behind_name or self.words.is_determined(position + 2))

    def negations(self, state: ReadingState, word: str) -> States:
        """Yield the state behind "not", "without" or the like."""
        if word == "nor":
            for closed in state.closed():
                if closed.done and not closed.negated:
                    yield closed.then(join=closed.join or "and", negated=True)
            return
        if state.outer is not None or state.number:
            return
        weak = state.weak
        if word.startswith(("without", "lack")):
            weak += ("with",)
        yield state.then(weak=weak, noun="", negated=not state.negated)

    def cues(self, state: ReadingState, word: str) -> States:
        """Yield the states behind a word that says a relation, or changes nothing."""
        start = state.position
        last = "" if state.join else state.last
        said = self.vocabulary.said(word)
        is_request = word in WORDS["requests"] and self.words[start + 1] in ("me", "us")
        if said and not is_request:
            both = said & (state.strong or said)
            if both:
                is_counted = state.number != "" or self.words[start - 1] == "no"
                noun = self.vocabulary.noun(word, is_counted)
                weak = () if noun else state.weak
                yield state.then(strong=both, noun=noun, weak=weak)
            is_location = word == "used" and self.words[start + 1] in ("in", "at", "on")
            if state.is_unsaid and (last in said or is_location):
                yield state.then()  # "round shape", "red in colour", "used in the kitchen"
        for relation in state.strong or ():
            if near(word, self.vocabulary.words[relation], INFLECTED) and not said:
                yield state.then()  # "avoids contact with"
        if word == "=" and state.strong is not None:  # "material = wood"
            yield state.then()
        if word in WEAK:
            yield state.then(weak=(*state.weak, word))
            is_verb = self.vocabulary.family(last).takes_object
            is_counted = last != "" and state.done[-1].text.startswith("count ")
            is_behind = word not in ("with", "of") and not is_counted
            if last and (is_behind or is_verb):
                yield state.then(cost=state.cost + 0.01)  # "to drink from"
            if self.words[start - 1] in WORDS["requests"] and not state.done:
                yield state.then()  # "look for", "want to"
        if word in WORDS["things"]:
            name = state.other_name if word in ("one", "ones") else ""
            if name and state.is_bare and not state.join:
                condition = ReadCondition(name, IS, name=name, is_bare=True)
                named = state.named(condition, 1, 0.0)
                if named is not None:
                    yield named
                return
            if state.is_phrase_clear:
                yield state.behind_thing()
            if state.noun:  # "not carrying anything"
                yield state.then()
        elif word == "whose" and not self.vocabulary.said(self.words[start + 1]):
            return  # "whose cover is red" is not red
        elif word == "can" and self.words.matches[start]:
            return
        elif word in IGNORED or word in WORDS["able"]:
            if word in WORDS["able"] and not state.weak:
                yield state.then(weak=("to",))
            takes_object = state.takes_object and word in WORDS["determiners"]
            yield state.then(takes_object=takes_object)
        if word in WORDS["requests"] and state.is_unsaid and not state.done:
            yield state.then()

    def values(self, state: ReadingState) -> States:
        """Yield the states behind the values that stand at a place."""
        if state.number or state.best:
            return
        matches = self.words.matches[state.position]
        longest = max(map(attrgetter("length"), matches), default=0)
        has_name = False
        for match in matches:
            has_name |= match.length == longest and match.entry.relation == IS
        for match in matches:
            if match.length < longest:
                continue
            if match.entry.relation == IS:
                yield from self.names(state, match)
                continue
            cost = self.cost(state, match)
            if cost is not None:
                if has_name and state.is_bare:  # "a brush" is one
                    cost += OTHER_THAN_NAME
                yield self.with_value(state, match, cost)

    def cost(self, state: ReadingState, match: Match) -> float | None:
        """Return what it costs to read words as a value, None if they cannot be."""
        entry = match.entry
        if self.is_kept_out(state, entry, match.far):
            return None
        cost = self.fits(entry, state)
        if cost is None:
            return None
        if entry in self.vocabulary.elsewhere:
            cost += INFLECTED
        if self.vocabulary.is_implied(entry.relation):
            cost += INFLECTED
        return cost + match.far

    def is_kept_out(self, state: ReadingState, entry: Entry, far: float) -> bool:
        """Return whether the words at a place may not be a value, though they are near to it."""
        is_verb = far == INFLECTED and entry.words[-1].endswith("ing")
        if is_verb and not self.is_purpose(state):
            return True
        if state.takes_object and state.is_bare and not state.join:
            # "to cut wood" is not made of wood
            return entry.relation != COLOUR_RELATION
        # "for water" is not to water, though "water" is its verb
        is_for = far > 0 and state.weak[-1:] == ("for",)
        return is_for and self.words.has_exact(state.position, entry)

    def names(self, state: ReadingState, match: Match) -> States:
        """Yield the state behind the name of an object."""
        if not state.is_bare or state.takes_object:
            return
        condition = ReadCondition(
            match.entry.text,
            IS,
            name=match.entry.text,
            is_bare=True,
            is_determined=self.words.is_determined(state.position),
        )
        named = state.named(condition, match.length, match.far)
        if named is not None:
            yield named

    def with_value(
        self, state: ReadingState, match: Match, cost: float
    ) -> ReadingState:
        """Return the state behind a value."""
        entry = match.entry
        relation = entry.relation
        condition = ReadCondition(
            entry.text,
            relation,
            is_bare=state.is_bare,
            is_determined=self.words.is_determined(state.position),
            reach=self.words.reach(state.position),
        )
        is_verb = self.vocabulary.family(relation).takes_object or entry.role == "verb"
        takes_object = is_verb and not state.is_bare
        added = state.added(condition, match.length, cost)
        return replace(added, takes_object=takes_object)

    def is_purpose(self, state: ReadingState) -> bool:
        """Return whether a value that is a verb may be meant: not by "light" and "stored"."""
        word = self.words[state.position]
        before = self.words[state.position - 1]
        if word.endswith("s") and before in ("that", "which", "what"):
            return True
        is_said = state.strong is not None or "for" in state.weak or "to" in state.weak
        continues = bool(state.join and state.done) and "ing" in state.done[-1].text
        return (is_said or continues) and not word.endswith("ed")

    def fits(self, entry: Entry, state: ReadingState) -> float | None:
        """Return what it costs to read a value by the words before it, None if it cannot be."""
        relation = entry.relation
        strong = state.strong or ()
        if relation in self.vocabulary.denials and relation not in strong:
            return None  # "for children" is not unsafe for them
        if state.outer is not None:  # what a thing is, that was said before it
            if not entry.inner or relation not in state.outer:
                return None
            if entry.inner in strong or self.is_allowed(entry.inner, state):
                return 0.0
            return None
        if entry.role:
            return self.fits_by_role(entry, state)
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
            if not prepositions.isdisjoint(state.weak):  # "safe for"
                prepositions.clear()
            if state.weak[-1:] == ("by",):  # "grasped by the handle"
                prepositions.discard("at")
            return None if prepositions or not strong else cost
        if not state.is_unsaid:
            return cost
        family = self.vocabulary.family(relation)
        continues = state.join != "" and state.done != ()
        if continues and relation == state.last:
            return cost
        is_other = family.relations == "" and not is_adjective(entry.words[-1])
        if entry in self.vocabulary.elsewhere and family is FAMILIES["relation"]:
            return None
        if entry.inner or is_other:
            return None
        if family.describes and not continues:
            return 0.0
        if family.describes or family.relations == "" or not state.done:
            return 0.05
        return None

    def fits_by_role(self, entry: Entry, state: ReadingState) -> float | None:
        """Return as `fits` of CAN_OPEN, said as to open, and of HAS_SWITCH, as with a switch."""
        strong = state.strong or (entry.relation,)
        if state.outer is not None or entry.relation not in strong:
            return None
        prepositions = {"to", "for"}
        if entry.role in ("part", "head"):
            prepositions = set(FAMILIES["part"].weak)
        is_allowed = not prepositions.isdisjoint(state.weak)
        continues = state.join != "" and state.is_bare and state.last == entry.relation
        if entry.role == "verb" and entry.words[-1] in WORDS["intransitive"]:
            before = self.words[state.position - 1]
            is_allowed |= before in ("that", "which", "it", "not", "may", "might")
        cost = OTHER_THAN_NAME if entry.role == "head" else 0.0
        return cost if is_allowed or continues else None

    def is_allowed(self, relation: str, state: ReadingState) -> bool:
        """Return whether one of the last prepositions can stand before a value of a relation."""
        return not self.vocabulary.prepositions(relation).isdisjoint(state.weak)

    def numbered(self, state: ReadingState, word: str) -> States:
        """Yield the states behind a number: compared with what was said, or of what follows."""
        sign, digits = _COMPARED.findall(word)[0]
        number = f"{sign or '='} {digits}"
        is_money = self.words[state.position + 1] in WORDS["money"]
        length = 1 + is_money
        relations: Collection[str] = state.strong or ()
        if is_money and state.is_bare:  # "under 6 euros"
            relations = self.vocabulary.of_family("price")
        for relation in sorted(relations):
            if relation in self.vocabulary.numbers:
                yield self.with_number(state, relation, number, length)
        last = state.last if state.join else ""
        if state.is_bare and last in self.vocabulary.numbers:  # "price >= 3 and <= 6"
            yield self.with_number(state, last, number, length)
        if state.noun:
            yield state.then(number=number)
        elif state.strong is None and digits.isdecimal():
            yield state.then(number=number, weak=())

    def with_number(
        self, state: ReadingState, relation: str, number: str, length: int
    ) -> ReadingState:
        """Return the state behind a comparison of a relation with a number, such as "< 6"."""
        text = f"{quoted(relation)} {number}"
        return state.added(ReadCondition(text, relation), length)

    def superlatives(self, state: ReadingState, word: str) -> States:
        """Yield the states behind "most parts", "the cheapest", "lowest price", "cheaper than"."""
        end = state.position + 1
        best = _BEST.get(word)
        if best:
            yield state.then(best=best, weak=())
            for relation in sorted(self.vocabulary.said(self.words[end])):
                if relation in self.vocabulary.numbers:
                    text = quoted(relation)
                    yield state.added(ReadCondition(text, relation, best=best), 2)
        adjective = word
        if word in ("most", "least", "more", "less"):
            adjective = self.words[end]
            end += 1
        relation, sign = self.vocabulary.measured(adjective)
        if not relation:
            return
        if word in ("least", "less"):
            sign = "<" if sign == ">" else ">"
        length = end - state.position
        number = self.words[end + 1]
        if word.endswith("est") or word in ("most", "least"):
            condition = ReadCondition(quoted(relation), relation, best=sign)
            yield state.added(condition, length)
        elif self.words[end] == "than" and re.fullmatch(NUMBER, number):
            length += 2 + (self.words[end + 2] in WORDS["money"])
            yield self.with_number(state, relation, f"{sign} {number}", length)


def refusal(
    text: str, why: str, words: Sequence[str], vocabulary: Vocabulary
) -> UserError:
    """Return the error of a question that is not understood, with the nearest conditions."""
    values = [word for word in words if word not in _NO_HINT]
    nearest = vocabulary.nearest(values)
    return UserError(f"The question {text!r} is not understood: {why}. {nearest}")
