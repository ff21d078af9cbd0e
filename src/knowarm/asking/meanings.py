"""Meanings of words: what of a graph, and which objects, the words of a question may stand for."""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from itertools import chain
from operator import attrgetter
from typing import NamedTuple

from knowarm.asking.lexicon import (
    BESIDE,
    EXTREMES,
    INFLECTED,
    JOINS,
    SYNONYM,
    WEAK,
    WORDS,
    distance,
    near,
    synonyms_of,
    verbs_of,
)
from knowarm.asking.relations import IS
from knowarm.asking.vocabulary import Entry, Vocabulary
from knowarm.questions import COLOUR_RELATION

IGNORED = WORDS.things | WORDS.ignored
"""Words that change nothing, or stand for any object."""
NO_VALUE = IGNORED.union(WORDS.negations, WEAK, JOINS, BESIDE, EXTREMES, "=")
"""Words that are no values."""
LONGEST_VALUE = 3
"""Most words of a value that is looked up in the whole graph."""


class Match(NamedTuple):
    """A condition that words may mean, how far they are from its value, and how many they are."""

    entry: Entry
    far: float
    length: int


class Meanings:
    """The words of a question, and what may be meant by those from each one on.

    Attributes:
        words: the words.
        matches: by position, the conditions whose values the words from there on may be.
    """

    def __init__(self, words: Sequence[str], vocabulary: Vocabulary) -> None:
        self.vocabulary = vocabulary
        self.words = list(self._without_endings(words))
        starts = range(len(self.words))
        for start in starts:
            self._look_up(start)
        self.matches = list(map(self._match, starts))

    def __getitem__(self, position: int) -> str:
        """Return the word at a position, or a comma before the beginning and behind the end."""
        if 0 <= position < len(self.words):
            return self.words[position]
        return ","

    def __len__(self) -> int:
        return len(self.words)

    def is_known(self, start: int, length: int) -> bool:
        """Return whether words are a value of an object, or a word says a relation."""
        for entry, far, matched in self._match(start):
            if far <= INFLECTED and not entry.inner and matched >= length:
                return True
        return length == 1 and bool(self.vocabulary.said(self[start]))

    def has_exact(self, position: int, entry: Entry) -> bool:
        """Return whether words are exactly another value than that of an entry."""
        return any(
            far == 0 and not other.inner and other.text != entry.text
            for other, far, _ in self.matches[position]
        )

    def is_kind(self, position: int) -> bool:
        """Return whether a word is a kind, such as "tool", that the graph does not know."""
        is_known = any(
            far <= INFLECTED and not entry.inner and entry.relation.family.describes
            for entry, far, _ in self.matches[position]
        )
        return not is_known and near(self[position], WORDS.kinds, 0)

    def is_determined(self, position: int) -> bool:
        """Return whether a determiner stands before a word."""
        return self[position - 1] in WORDS.determiners

    def is_verb(self, position: int) -> bool:
        """Return whether a word is where verbs are: "that waters", "does not water"."""
        before = self[position - 1]
        if before == "not":
            before = self[position - 2]
        if before in WORDS.auxiliaries:
            return True
        return before in WORDS.doers and self[position].endswith("s")

    def is_name(self, position: int) -> bool:
        """Return whether a word may be the name of an object."""
        return any(
            entry.relation == IS and len(entry.words) == 1
            for entry in self.vocabulary.starting(self[position])
        )

    def reach(self, position: int) -> str:
        """Return how far a "not" before a word reaches: over the "word", a "phrase", or "open"."""
        before = self[position - 1]
        if before == "non":
            return "word"
        is_phrase = before in WORDS.before_nouns and before != "not"
        return "phrase" if is_phrase else "open"

    @property
    def has_object(self) -> bool:
        """Whether the words name an object, or a colour that the image shows."""
        matches = chain.from_iterable(self.matches)
        names = {match.entry.relation.name for match in matches}
        return not names.isdisjoint((IS.name, COLOUR_RELATION))

    def phrases(self, positions: Sequence[int]) -> list[str]:
        """Return the words at positions; those that determiners alone separate are one phrase."""
        phrases: list[str] = []
        end = len(self)
        for position in positions:
            between = self.words[end:position]
            text = " ".join([*between, self[position]])
            if end <= position and WORDS.determiners.issuperset(between):
                phrases[-1] += f" {text}"
            else:
                phrases.append(self[position])
            end = position + 1
        return phrases

    def _without_endings(self, words: Sequence[str]) -> Iterator[str]:
        """Yield words, and two for one that says what is missing: "lidless" is without a lid."""
        for word in words:
            stem = word.removesuffix("less")
            is_missing = stem != word and not any(self.vocabulary.starting(word))
            if is_missing and any(self.vocabulary.starting(stem)):
                yield "without"
                word = stem
            yield word

    def _look_up(self, start: int) -> None:
        """Learn the values of the whole graph that the words from one on are."""
        if not self[start].isalpha():
            return
        for length in range(1, LONGEST_VALUE + 1):
            words = self.words[start : start + length]
            if len(words) < length or not NO_VALUE.isdisjoint(words):
                return
            if not self.is_known(start, length):
                self.vocabulary.look_up(words)

    def _match(self, start: int) -> list[Match]:
        """Return the values that may be meant by the words from one on."""
        word = self[start]
        if word in NO_VALUE - IGNORED:
            return []
        matches = []
        for entry in self.vocabulary.starting(word):
            match = self._matched(start, entry)
            if match is not None and self._may_be(match, start):
                matches.append(match)
        whole = word + self[start + 1]
        starting = self.vocabulary.starting(whole)  # "coffee table" of `coffeetable`
        matches += [Match(one, 0.0, 2) for one in starting if one.words == (whole,)]
        if word in IGNORED:  # "can be heated"
            return [match for match in matches if match.length > 1]
        for verb in sorted(verbs_of(word)):  # "openable" of what "can open"
            for entry in self.vocabulary.starting(verb):
                is_verb = entry.role == "verb" and len(entry.words) == 1
                if is_verb and near(verb, entry.words, INFLECTED):
                    adjective = entry._replace(role="")
                    matches.append(Match(adjective, INFLECTED, 1))
        return list(_inflections_joined(matches))

    def _matched(self, start: int, entry: Entry) -> Match | None:
        """Return how the words from one on match a value, None if they do not."""
        total = 0.0
        position = start
        for name in entry.words:
            while position > start and self[position] in WORDS.within_values:
                position += 1  # "tell the time"
            far = distance(self[position], name)
            if far is None:
                return None
            total += far
            position += 1
        return Match(entry, total, position - start)

    def _may_be(self, match: Match, start: int) -> bool:
        """Return whether words may be what they match: names are near, and "can" may be a verb."""
        if match.entry.relation != IS:
            # "what you use" is no exercise, a synonym of use
            is_cue = match.length == 1 and bool(self.vocabulary.said(self[start]))
            return match.far < SYNONYM or not is_cue
        name = match.entry.words
        if name == ("can",):
            return self._is_noun(start)
        return match.far <= INFLECTED or name[0] in synonyms_of(self[start])

    def _is_noun(self, position: int) -> bool:
        """Return whether "can" is the object: "a can", "the red can with a lid"."""
        before = self[position - 1]
        behind = self[position + 1]
        if before in WORDS.before_nouns:
            return True
        ends = WORDS.behind_nouns.union(JOINS, WEAK, BESIDE, EXTREMES)
        is_value = before not in (*NO_VALUE, *WORDS.able)
        is_value = is_value and not self.is_name(position - 1)
        return behind in ends or (is_value and behind not in WORDS.behind_verbs)


def _inflections_joined(matches: Sequence[Match]) -> Iterator[Match]:
    """Yield matches with the forms of one word as one of them: ``affords drink`` and ``drinks``."""
    alike = defaultdict[tuple[object, ...], dict[str, Match]](dict)
    for match in matches:
        if match.far > INFLECTED:
            yield match
            continue
        key = (*match.entry[1:2], *match.entry[3:], match.length)
        by_text = alike[key]
        nearer = by_text.get(match.entry.text, match)
        by_text[match.entry.text] = min(nearer, match, key=attrgetter("far"))
    for by_text in alike.values():
        nearest = min(by_text.values(), key=attrgetter("far"))
        text = " or ".join(by_text)
        if len(by_text) > 1:
            text = f"({text})"
        yield nearest._replace(entry=nearest.entry._replace(text=text))
