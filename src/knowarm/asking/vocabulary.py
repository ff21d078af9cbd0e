"""Vocabulary of a graph: what can be asked about objects, and the English words that say it."""

import re
from collections import defaultdict
from collections.abc import Collection, Iterator
from difflib import get_close_matches
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
    spaced,
)
from knowarm.asking.quotes import condition, quoted
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.terms import label_of, local_name, name_key
from knowarm.questions import COLOUR_RELATION

_EMPTY = {*WEAK, "is", "are", "a", "an", "the", "be", "can"}
_HAVE = FAMILIES["part"].weak


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

    Attributes:
        words: the words of each relation.
        entries: what can be asked, once each.
        by_first: the same, by the first word of its value.
        numbers: by relation, the numbers that it states, by what it states them of.
        counts: by relation, the number of values that it states, by entity.
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
        self.objects = set(map(words_of, objects))
        self.words: dict[str, tuple[str, ...]] = {COLOUR_RELATION: ("has", "colour")}
        entries = []
        for colour in colours:
            text = condition(COLOUR_RELATION, colour)
            entries.append(Entry(words_of(colour), COLOUR_RELATION, text))
        for name, tail in self._pairs(heads):
            if name_key(name) in ("hascolor", "hascolour"):
                continue
            entries.append(self._entry(name, tail))
            for inner, end in self._pairs([tail]):
                entries.append(self._entry(name, end, inner))
        self.entries = list(dict.fromkeys(entries))
        self.by_first = defaultdict[str, list[Entry]](list)
        for entry in self.entries:
            if entry.words:
                self.by_first[entry.words[0]].append(entry)
        self.numbers = defaultdict[str, dict[int, float]](dict)
        none = dict.fromkeys(heads, 0.0)
        self.counts = defaultdict[str, dict[int, float]](none.copy)
        for head, relation, tail in self._facts(heads):
            name = graph.relation_names.short(relation)
            self.counts[name][head] += 1
            text = local_name(graph.names[tail])
            if re.fullmatch(r"\d+(\.\d+)?", text):
                self.numbers[name][head] = float(text)

    def _label(self, name: str) -> str:
        labels = self.graph.labels
        if name.startswith("/") and name not in labels:  # of ConceptNet
            return name
        return label_of(name, labels)

    def _facts(self, heads: Collection[int]) -> Iterator[tuple[int, int, int]]:
        """Yield the triples whose heads are some entities."""
        graph = self.graph
        for head in heads:
            for row in graph.out_rows(head):
                yield head, int(graph.relations[row]), int(graph.tails[row])

    def _pairs(self, heads: Collection[int]) -> Iterator[tuple[str, int]]:
        """Yield the relations of entities and what they lead to, and learn their words."""
        names = self.graph.relation_names
        pairs = {(relation, tail) for _, relation, tail in self._facts(heads)}
        for relation, tail in sorted(pairs):
            name = names.short(relation)
            self.words.setdefault(name, words_of(self._label(names[relation])))
            yield name, tail

    def _entry(self, relation: str, tail: int, inner: str = "") -> Entry:
        """Return the condition of one relation, or of two: "usedFor (relatedTo tea)"."""
        names = self.graph.names
        value = local_name(names.short(tail))
        text = condition(relation, value)
        if inner:
            text = f"{quoted(relation)} ({condition(inner, value)})"
        return Entry(words_of(self._label(names[tail])), relation, text, inner)

    def family(self, relation: str) -> Family:
        """Return the family of a relation."""
        name = " ".join(self.words[relation])
        for family in FAMILIES.values():
            if re.search(family.relations, name):
                return family
        return Family()

    def said(self, word: str) -> frozenset[str]:
        """Return the relations that a word says: with its own word, or with one of its family."""
        relations = set()
        for relation, words in self.words.items():
            is_name = near(word, set(words) - _EMPTY, DERIVED)
            if is_name or near(word, self.family(relation).strong, INFLECTED):
                relations.add(relation)
        return frozenset(relations)

    def noun(self, word: str, counted: bool = False) -> str:
        """Return the relation whose values a word counts, as "parts" those of hasPart, or "".

        ``counted``: behind a number "use" is a noun; else it may be a verb, as "uses" is not.
        """
        is_use = word in WORDS["uses"] or (counted and word in WORDS["use"])
        for relation, words in self.words.items():
            if not words:
                continue
            family = self.family(relation)
            is_noun = words[0] in _HAVE or family is FAMILIES["part"]
            if relation != COLOUR_RELATION and is_noun and near(word, words[-1:], 0):
                return relation
            if is_use and family is FAMILIES["use"]:
                return relation
        return ""

    def prepositions(self, relation: str) -> set[str]:
        """Return the prepositions and forms of "have" that may precede values of a relation."""
        return {*self.words[relation], *self.family(relation).weak}

    def measured(self, word: str) -> tuple[str, str]:
        """Return the relation of numbers that an adjective is about, and ">" or "<", or ""."""
        for relation in self.words:
            family = self.family(relation)
            if relation not in self.numbers:
                continue
            if near(word, family.large, INFLECTED):
                return relation, ">"
            if near(word, family.small, INFLECTED):
                return relation, "<"
        return "", ""

    def nearest(self, words: Collection[str]) -> str:
        """Return a sentence with the conditions whose values are nearest to words."""
        texts = []
        by_word = {}
        examples = {}
        colours = []
        for entry in self.entries:
            by_word.update(dict.fromkeys(entry.words, entry.text))
            if any(near(word, entry.words, SYNONYM) for word in words):
                texts.append(entry.text)
            if not entry.inner:
                examples[entry.relation] = entry.text
            if entry.relation == COLOUR_RELATION:
                colours.append(entry.text)
        for word in words:
            texts += map(by_word.__getitem__, get_close_matches(word, by_word, n=1))
        if not texts and any(COLOUR_RELATION in self.said(word) for word in words):
            texts = colours
        if texts:
            return f"Nearest: {'; '.join(list(dict.fromkeys(texts))[:9])}."
        return f"It can be asked for, among others: {'; '.join(list(examples.values())[:6])}."


def words_of(label: str) -> tuple[str, ...]:
    """Return the words of a name or label in lower case."""
    label = re.sub(r"^/(?:c/\w+|r)/([^/]+).*", r"\1", label)  # of ConceptNet
    return tuple(re.findall(r"[^\W_]+(?:\.\d+)?", spaced(label).casefold()))
