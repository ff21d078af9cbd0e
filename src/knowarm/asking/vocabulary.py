"""Vocabulary of a graph: what can be asked about objects, and the English words that say it."""

import re
import unicodedata
from collections import defaultdict
from collections.abc import Collection, Iterator
from difflib import get_close_matches
from itertools import product
from typing import NamedTuple

from knowarm.asking.lexicon import (
    DERIVED,
    FAMILIES,
    INFLECTED,
    SYNONYM,
    WEAK,
    WORDS,
    Family,
    near,
)
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.terms import label_of, local_name, name_key
from knowarm.questions import COLOUR_RELATION

_EMPTY = {*WEAK, "is", "are", "a", "an", "the", "be", "can"}
_HAVE = FAMILIES["part"].weak.split()


class Entry(NamedTuple):
    """A condition of the graph, and the words of its value."""

    words: tuple[str, ...]
    relation: str
    text: str
    inner: str = ""  # The second relation of a chain


class Vocabulary:
    """What can be asked about some entities of a graph.

    Args:
        graph: the graph.
        heads: ids of the entities that questions are about.
        colours: the colours that images show.
        objects: names of the objects, which questions do not say.
    """

    def __init__(
        self,
        graph: KnowledgeGraph,
        heads: Collection[int],
        colours: Collection[str],
        objects: Collection[str] = (),
    ) -> None:
        self.graph = graph
        self.heads = heads
        self.objects = {tuple(words_of(name)) for name in objects}
        self.words = {COLOUR_RELATION: ["has", "colour"]}
        entries = dict[Entry, None]()  # in order, once each
        for colour in colours:
            text = f"{COLOUR_RELATION} {_quoted(colour)}"
            entries[Entry(tuple(words_of(colour)), COLOUR_RELATION, text)] = None
        for name, tail in self._pairs(heads):
            if name_key(name) in ("hascolor", "hascolour"):
                continue
            entries[self._entry(name, tail)] = None
            for inner, end in self._pairs([tail]):
                entries[self._entry(name, end, inner)] = None
        self.entries = list(entries)
        self.by_first: dict[str, list[Entry]] = defaultdict(list)
        for entry in entries:
            if entry.words:
                self.by_first[entry.words[0]].append(entry)

    def _label(self, name: str) -> str:
        labels = self.graph.labels
        if name.startswith("/") and name not in labels:  # of ConceptNet
            return name
        return label_of(name, labels)

    def _pairs(self, heads: Collection[int]) -> Iterator[tuple[str, int]]:
        """Yield the relations of entities and what they lead to, and learn their words."""
        graph = self.graph
        pairs = set[tuple[int, int]]()
        for head in heads:
            rows = graph.out_rows(head)
            pairs.update(
                zip(
                    graph.relations[rows].tolist(),
                    graph.tails[rows].tolist(),
                    strict=True,
                )
            )
        for relation, tail in sorted(pairs):
            name = graph.relation_names.short(relation)
            self.words.setdefault(
                name, words_of(self._label(graph.relation_names[relation]))
            )
            yield name, tail

    def _entry(self, relation: str, tail: int, inner: str = "") -> Entry:
        """Return the condition of one relation, or of two: "usedFor (relatedTo tea)"."""
        name = self.graph.names[tail]
        value = _quoted(local_name(self.graph.names.short(tail)))
        text = f"{relation} ({inner} {value})" if inner else f"{relation} {value}"
        return Entry(tuple(words_of(self._label(name))), relation, text, inner)

    def family(self, relation: str) -> Family:
        """Return the family of a relation."""
        name = " ".join(self.words[relation])
        for family in FAMILIES.values():
            if re.search(family.relations, name):
                return family
        return Family()

    def said(self, word: str) -> frozenset[str]:
        """Return the relations that a word says: with its own word, or with one of its family."""
        relations = set[str]()
        for relation, words in self.words.items():
            names = [name for name in words if name not in _EMPTY]
            strong = self.family(relation).strong.split()
            is_name = any(near(word, name, DERIVED) for name in names)
            if is_name or any(near(word, other, INFLECTED) for other in strong):
                relations.add(relation)
        return frozenset(relations)

    def noun(self, word: str, counted: bool = False) -> str:
        """Return the relation whose values a word counts, as "parts" those of hasPart, or "".

        ``counted``: behind a number "use" is a noun; else it may be a verb, as "uses" is not.
        """
        uses = WORDS["uses"] + WORDS["use"] if counted else WORDS["uses"]
        for relation, words in self.words.items():
            family = self.family(relation)
            is_noun = words[0] in _HAVE or family is FAMILIES["part"]
            if relation != COLOUR_RELATION and is_noun and near(word, words[-1], 0):
                return relation
            if word in uses and family is FAMILIES["use"]:
                return relation
        return ""

    def allows(self, word: str, relation: str) -> bool:
        """Return whether a preposition or "has" can stand before a value of a relation."""
        return (
            word in self.words[relation] or word in self.family(relation).weak.split()
        )

    def numbers(self, relation: str) -> dict[int, float]:
        """Return the numbers that a relation states, by what it states them of."""
        numbers = dict[int, float]()
        for head, tail in self._links(relation):
            text = local_name(self.graph.names[tail])
            if re.fullmatch(r"\d+(\.\d+)?", text):
                numbers[head] = float(text)
        return numbers

    def counts(self, relation: str) -> dict[int, float]:
        """Return the number of values that a relation states, by entity."""
        counts = dict.fromkeys(self.heads, 0.0)
        for head, _ in self._links(relation):
            counts[head] += 1
        return counts

    def _links(self, relation: str) -> Iterator[tuple[int, int]]:
        """Yield the entities of which a relation states something, and what."""
        graph = self.graph
        for head in self.heads:
            for row in graph.out_rows(head):
                if graph.relation_names.short(graph.relations[row]) == relation:
                    yield head, int(graph.tails[row])

    def measured(self, word: str) -> tuple[str, str]:
        """Return the relation of numbers that an adjective is about, and ">" or "<", or ""."""
        for sign, size in ((">", "large"), ("<", "small")):
            for relation in self.words:
                adjectives = getattr(self.family(relation), size).split()
                is_near = any(
                    near(word, adjective, INFLECTED) for adjective in adjectives
                )
                if is_near and self.numbers(relation):
                    return relation, sign
        return "", ""

    def nearest(self, words: Collection[str]) -> str:
        """Return a sentence with the conditions whose values are nearest to words."""
        texts = list[str]()
        by_word = dict[str, str]()
        for entry in self.entries:
            by_word.update(dict.fromkeys(entry.words, entry.text))
            if any(
                near(word, other, SYNONYM)
                for word, other in product(words, entry.words)
            ):
                texts.append(entry.text)
        for word in words:
            texts += map(by_word.__getitem__, get_close_matches(word, by_word, n=1))
        if not texts and any(COLOUR_RELATION in self.said(word) for word in words):
            texts = [
                entry.text
                for entry in self.entries
                if entry.relation == COLOUR_RELATION
            ]
        if texts:
            return f"Nearest: {'; '.join(list(dict.fromkeys(texts))[:9])}."
        examples = {
            entry.relation: entry.text for entry in self.entries if not entry.inner
        }
        return f"It can be asked for, among others: {'; '.join(list(examples.values())[:6])}."


def words_of(label: str) -> list[str]:
    """Return the words of a name or label in lower case."""
    text = re.sub(
        r"^/(?:c/\w+|r)/([^/]+).*", r"\1", unicodedata.normalize("NFC", label)
    )
    text = re.sub(
        r"(?<=[a-z0-9])(?=[A-Z])", " ", text
    )  # and ConceptNet's /r/UsedFor above
    return re.findall(r"[^\W_]+(?:\.\d+)?", text.casefold())


def _quoted(name: str) -> str:
    """Return a name as questions write it."""
    if re.fullmatch(r"[^\s()<>=!\"]+", name):
        return name
    return f'"{name}"'
