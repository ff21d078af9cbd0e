"""Vocabulary of a graph: what can be asked about objects, and the English words that say it."""

import re
import unicodedata
from collections import Counter, defaultdict
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
        self.graph, self.heads = graph, heads
        self.objects = {tuple(words_of(name)) for name in objects}
        self.words = {COLOUR_RELATION: ["has", "colour"]}
        self.entries = [
            Entry(tuple(words_of(colour)), COLOUR_RELATION, f"{COLOUR_RELATION} {_quoted(colour)}")
            for colour in colours
        ]
        for name, tail in self._pairs(heads):
            if name_key(name) not in ("hascolor", "hascolour"):
                self.entries.append(self._entry(name, tail))
                self.entries += [
                    self._entry(f"{name} ({inner}", end) for inner, end in self._pairs([tail])
                ]
        self.entries = list(dict.fromkeys(self.entries))
        self.by_first: dict[str, list[Entry]] = defaultdict(list)
        for entry in filter(lambda each: each.words, self.entries):
            self.by_first[entry.words[0]].append(entry)

    def _label(self, name: str) -> str:
        labels = self.graph.labels
        return name if name.startswith("/") and name not in labels else label_of(name, labels)

    def _pairs(self, heads: Collection[int]) -> Iterator[tuple[str, int]]:
        """Yield the relations of entities and what they lead to, and learn their words."""
        graph = self.graph
        rows = [row for head in heads for row in graph.out_rows(head)]
        pairs = {(int(graph.relations[row]), int(graph.tails[row])) for row in rows}
        for relation, tail in sorted(pairs):
            name = graph.relation_names.short(relation)
            self.words.setdefault(name, words_of(self._label(graph.relation_names[relation])))
            yield name, tail

    def _entry(self, relations: str, tail: int) -> Entry:
        """Return the condition of one relation, or of two: "usedFor (relatedTo"."""
        graph, (relation, _, inner) = self.graph, relations.partition(" (")
        words = words_of(self._label(graph.names[tail]))
        text = f"{relations} {_quoted(local_name(graph.names.short(tail)))}" + ")" * bool(inner)
        return Entry(tuple(words), relation, text, inner)

    def family(self, relation: str) -> Family:
        """Return the family of a relation."""
        name = " ".join(self.words[relation])
        return next((f for f in FAMILIES.values() if re.search(f.relations, name)), Family())

    def said(self, word: str) -> frozenset[str]:
        """Return the relations that a word says: with its own word, or with one of its family."""
        return frozenset(
            name
            for name, words in self.words.items()
            if any(near(word, each, DERIVED) for each in words if each not in _EMPTY)
            or any(near(word, each, INFLECTED) for each in self.family(name).strong.split())
        )

    def noun(self, word: str, counted: bool = False) -> str:
        """Return the relation whose values a word counts, as "parts" those of hasPart, or "".

        ``counted``: behind a number "use" is a noun; else it may be a verb, as "uses" is not.
        """
        for name, words in self.words.items():
            is_noun = words[0] in _HAVE or self.family(name) is FAMILIES["part"]
            if name != COLOUR_RELATION and is_noun and near(word, words[-1], 0):
                return name
            uses = WORDS["uses"] + WORDS["use"] * counted
            if word in uses and self.family(name) is FAMILIES["use"]:
                return name
        return ""

    def allows(self, word: str, relation: str) -> bool:
        """Return whether a preposition or "has" can stand before a value of a relation."""
        return word in self.words[relation] or word in self.family(relation).weak.split()

    def numbers(self, relation: str) -> dict[int, float]:
        """Return the numbers that a relation states, by what it states them of."""
        texts = [(head, local_name(self.graph.names[tail])) for head, tail in self._links(relation)]
        return {head: float(text) for head, text in texts if re.fullmatch(r"\d+(\.\d+)?", text)}

    def counts(self, relation: str) -> dict[int, float]:
        """Return the number of values that a relation states, by entity."""
        counted = Counter(head for head, _ in self._links(relation))
        return {head: float(counted[head]) for head in self.heads}

    def _links(self, relation: str) -> list[tuple[int, int]]:
        graph = self.graph
        rows = ((head, row) for head in self.heads for row in graph.out_rows(head))
        short = graph.relation_names.short
        return [(h, int(graph.tails[r])) for h, r in rows if short(graph.relations[r]) == relation]

    def measured(self, word: str) -> tuple[str, str]:
        """Return the relation of numbers that an adjective is about, and ">" or "<", or ""."""
        for sign, kind in ((">", "large"), ("<", "small")):
            for name in self.words:
                adjectives = getattr(self.family(name), kind).split()
                if any(near(word, each, INFLECTED) for each in adjectives) and self.numbers(name):
                    return name, sign
        return "", ""

    def nearest(self, words: Collection[str]) -> str:
        """Return a sentence with the conditions whose values are nearest to words."""
        every = {word: entry.text for entry in self.entries for word in entry.words}
        found = [
            entry.text
            for entry in self.entries
            if any(near(word, each, SYNONYM) for word in words for each in entry.words)
        ]
        found += [every[near] for word in words for near in get_close_matches(word, every, n=1)]
        if not found and any(COLOUR_RELATION in self.said(word) for word in words):
            found = [each.text for each in self.entries if each.relation == COLOUR_RELATION]
        if found:
            return f"Nearest: {'; '.join([*dict.fromkeys(found)][:9])}."
        firsts = {entry.relation: entry.text for entry in self.entries if not entry.inner}
        return f"It can be asked for, among others: {'; '.join([*firsts.values()][:6])}."


def words_of(label: str) -> list[str]:
    """Return the words of a name or label in lower case."""
    text = re.sub(r"^/(?:c/\w+|r)/([^/]+).*", r"\1", unicodedata.normalize("NFC", label))
    text = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", text)  # and ConceptNet's /r/UsedFor above
    return re.findall(r"[^\W_]+(?:\.\d+)?", text.casefold())


def _quoted(name: str) -> str:
    """Return a name as questions write it."""
    return name if re.fullmatch(r"[^\s()<>=!\"]+", name) else f'"{name}"'
