"""Lexicon of English: word lists, and how far words are from each other by form and synonyms."""

import lzma
import re
import unicodedata
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from knowarm.errors import UserError
from knowarm.knowledge.graph.homonyms import PLACES
from knowarm.knowledge.graph.terms import name_key
from knowarm.knowledge.vectors.words import DATA, word_forms
from knowarm.reading import read_toml

MOST_LETTERS = 2_000
"""Most letters of a question."""
INFLECTED = 0.1
DERIVED = 0.2
SYNONYM = 1.0
"""Distances of two words; 0 is the same word, in singular or plural."""
NUMBER = r"\d+(?:\.\d+)?(?:-\d\d-\d\d)?"
"""Pattern of numbers and dates."""
_ENGLISH = read_toml(Path(__file__).with_name("english.toml"))
Words = Sequence[str]
WORDS = SimpleNamespace(
    **{function: frozenset(words) for function, words in _ENGLISH["words"].items()}
)
"""Words of one function in questions, by it; the file says what they are."""
JOINS: dict[str, str] = _ENGLISH["joins"]
"""What joins conditions: "and", "or", "but" or a comma, by word."""
EXTREMES: dict[str, str] = _ENGLISH["extremes"]
"""Conditions of the object that is furthest in a direction, by word."""
BESIDE: dict[str, str] = _ENGLISH["beside"]
"""Conditions of the place beside another object, by word."""
UNANSWERED = re.compile("|".join(_ENGLISH["unanswered"]["asks"]))
"""Questions that ask for no object."""
DESTINATIONS: list[dict[str, Any]] = _ENGLISH["putting"]["destinations"]
"""Patterns of sentences that say what has to be put where, with an example of each."""
HOME: list[dict[str, Any]] = _ENGLISH["putting"]["home"]
"""The same of sentences that say that it has to be put where it belongs."""
_PARTS = {
    part: f"(?:{'|'.join(alternatives)})"
    for part, alternatives in _ENGLISH["putting"]["parts"].items()
}
"""What patterns of both are made of: a regular expression by its name in them."""
_ADJECTIVE = re.compile(
    r"(?:able|ible|ous|ful|less|ive|ic|al|ish|(?<![tgcrl])y|ed|ing|proof)$"
)
_TOKEN = re.compile(rf"(?:[<>!]=?|=){NUMBER}|{NUMBER}|[^\W\d_]+|\S")


@dataclass(frozen=True, eq=False)
class Family:
    """Relations that mean alike in any graph, and how English speaks of them."""

    relations: str = ""
    strong: Words = ()
    weak: Words = ()
    describes: bool = False
    large: Words = ()
    small: Words = ()
    otherwise: Words = ()
    takes_object: bool = False


_ENGLISH["relations"]["location"]["relations"] = PLACES
FAMILIES = {name: Family(**fields) for name, fields in _ENGLISH["relations"].items()}
WEAK = WORDS.weak.union(*(family.weak for family in FAMILIES.values()))
"""Prepositions, and verbs such as "has"."""


def tokens(text: str) -> list[str]:
    """Return the words of a question, with comparisons such as "at least two" as one: ">=2"."""
    if len(text) > MOST_LETTERS:
        raise UserError(
            f"Questions of {len(text):,} letters are not read: {text:.40} ..."
        )
    text = spaced(text).casefold()
    for pattern, replacement in _ENGLISH["rewritten"].items():
        text = re.sub(pattern.replace("#", NUMBER), replacement, text)
    return _TOKEN.findall(text)


def sentences(text: str) -> list[str]:
    """Return the sentences of a text."""
    ends = re.split(r"(?<!\bsth)(?<!\be\.g)[.!?;]+(?:\s+|$)", text, flags=re.IGNORECASE)
    return [sentence for sentence in ends if re.search(r"\w", sentence)] or [text]


def what_is_put(sentence: str) -> str:
    """Return "the mug" of "put the mug where it belongs"; other sentences as they are."""
    for form in HOME:
        match = match_putting(form["pattern"], sentence)
        if match is not None:
            return match["what"]
    return sentence


def match_putting(pattern: str, sentence: str) -> re.Match[str] | None:
    """Match a sentence with a pattern of `DESTINATIONS` or `HOME`, with or without "please"."""
    polite = f"{{request}}*{pattern}(?:,? please)?\\W*"
    return re.fullmatch(polite.format(**_PARTS), sentence, re.IGNORECASE)


def synonyms_of(word: str) -> set[str]:
    """Return the everyday synonyms of a word, in singular."""
    return set().union(*map(_table()["e"].__getitem__, forms_of(word)))


def spaced(text: str) -> str:
    """Return a text with a space between words that only a capital letter separates."""
    text = unicodedata.normalize("NFC", text)
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", text)


def near(word: str, others: Iterable[str], most: float) -> bool:
    """Return whether a word is within a distance of one of some others."""
    for other in others:
        far = distance(word, other)
        if far is not None and far <= most:
            return True
    return False


@cache
def distance(word: str, other: str) -> float | None:
    """Return how far a word is from another one that it may stand for, else None."""
    if name_key(word) == name_key(other):
        return 0.0
    # "fixing" is to fix, "store" a shop
    distances = _distances(word, "v" if other.endswith("ing") else "nae")
    forms = forms_of(other) & distances.keys()
    return min(map(distances.__getitem__, forms), default=None)


@cache
def related(word: str) -> frozenset[str]:
    """Return the forms of all words for which `distance` may be other than None."""
    return frozenset(_distances(word, "nvae"))


@cache
def _distances(word: str, kinds: str) -> dict[str, float]:
    """Return how far a word is from each form of others, by synonyms of some kinds."""
    table = _table()
    forms = forms_of(word)
    derived = forms.union(*map(table["d"].__getitem__, forms))
    distances = {}
    for kind, form in product(kinds, derived):
        distances.update(dict.fromkeys(table[kind][form], SYNONYM))
    distances.update(dict.fromkeys(derived, DERIVED))
    distances.update(dict.fromkeys(forms, INFLECTED))
    return distances


def verbs_of(word: str) -> set[str]:
    """Return the verbs that an adjective may be made of: "cuttable" of cut, "edible" of eat."""
    irregular = _ENGLISH["abilities"].get(word)
    if irregular:
        return {irregular}
    stem = re.sub(r"[ai]ble$", "", word)
    if stem == word or len(stem) < 2:
        return set()
    verbs = {stem, stem + "e"}
    if stem[-1] == stem[-2:-1]:
        verbs.add(stem[:-1])
    if stem.endswith("i"):
        verbs.add(stem[:-1] + "y")
    return verbs


def is_adjective(word: str) -> bool:
    """Return whether a word may be an adjective, by its ending or its synonyms."""
    return bool(_ADJECTIVE.search(word) or _table()["a"].get(word))


@cache
def forms_of(word: str) -> frozenset[str]:
    """Return a word and what it may be an inflected form of."""
    forms = {word, name_key(word), *word_forms(word), *_table()["i"][word]}
    if word.endswith("ed"):
        forms.add(word[:-1])  # used, stored
    for ending, noun_ending in _ENGLISH["endings"].items():
        if word.endswith(ending) and len(word) > len(ending) + 2:
            forms.add(word.removesuffix(ending) + noun_ending)
    for form in tuple(forms):
        if len(form) > 3 and form.endswith(("ll", "ss", "tt")):
            forms.add(form[:-1])
    return frozenset(forms)


@cache
def _table() -> dict[str, dict[str, set[str]]]:
    """Return other words by kind and word.

    Synonyms of nouns (n), verbs (v), adjectives (a) and everyday ones (e), derived words (d) and
    irregular forms (i).
    """
    table: dict[str, dict[str, set[str]]] = defaultdict(lambda: defaultdict(set))
    text = lzma.decompress((DATA / "wordnet-synonyms.txt.xz").read_bytes()).decode()
    for line in text.split("\n"):
        kind, *words = line.split(" ")
        for word in words:
            table[kind][word].update(words)
            table[kind][word].discard(word)
    for word, other in _ENGLISH["synonyms"].items():
        table["e"][word].add(other)
        table["e"][other].add(word)
    return table
