"""Vocabulary of a graph: what can be asked about objects, and the English words that say it."""

import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Sequence
from itertools import chain, islice
from typing import NamedTuple

import numpy as np

from knowarm.asking.lexicon import (
    DERIVED,
    FAMILIES,
    INFLECTED,
    SYNONYM,
    WEAK,
    WORDS,
    Family,
    forms_of,
    near,
    related,
    spaced,
    synonyms_of,
    verbs_of,
)
from knowarm.asking.quotes import condition, quoted
from knowarm.asking.relations import is_colour, kind_relations
from knowarm.knowledge.graph.denials import Stance, negative_words, opposed, stance
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.homonyms import is_class
from knowarm.knowledge.graph.individuals import classes_of
from knowarm.knowledge.graph.terms import RDFS, label_of, local_name, name_key
from knowarm.knowledge.vectors.words import shipped_vectors
from knowarm.questions import COLOUR_RELATION

_EMPTY = {*WEAK, "is", "are", "a", "an", "the", "be", "can", "does", "do"}
_HAVE = FAMILIES["part"].weak
_NEGATIONS = ("cannot", "doesnt", "isnt", "cant", "dont", "missing", "misses", "devoid")
IS = "is"
"""What stands in place of a relation before the name of an object."""
NEAR_HINT = 0.35
"""Least cosine of the words of a question and of a condition that is offered instead."""
MOST_HINTS = 9
LONGEST_VALUE = 3
"""Most words of a value that is looked up in the whole graph."""


class Entry(NamedTuple):
    """A condition of the graph, and the words of its value."""

    words: tuple[str, ...]
    relation: str
    text: str
    inner: str = ""  # The second relation of a chain
    role: str = ""  # "verb" of "can open", "part" of "has switch", "head"


class Vocabulary:
    """What can be asked about some entities of a graph.

    Args:
        graph: the graph.
        heads: ids of the entities that questions are about.
        colours: the colours that images show.
        objects: names of the objects.

    Attributes:
        words: the words of each relation.
        entries: what can be asked, once each.
        denials: relations whose names negate, with the words that do so and say them: "unsafe".
        affirming: by relation that denies, the name of the one that affirms the same.
        elsewhere: conditions that the graph states of other entities only.
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
        self.words: dict[str, tuple[str, ...]] = {COLOUR_RELATION: ("has", "colour")}
        self.denials: dict[str, set[str]] = {}
        self.affirming: dict[str, str] = {}
        self.entries: dict[Entry, None] = {}
        self.elsewhere = set[Entry]()
        self._by_form = defaultdict[str, set[str]](set)
        self._by_first = defaultdict[str, list[Entry]](list)
        self._said: dict[str, frozenset[str]] = {}
        self._families: dict[str, Family] = {}
        self._broader = _broader_relations(graph)
        stating, denying = kind_relations(graph)
        self._has_many_kinds = len(stating) + len(denying) > 1
        for name in objects:
            self._add(Entry(words_of(name), IS, f"{IS} {quoted(name)}"))
        self._colours = set(map(name_key, colours))
        for colour in colours:
            text = condition(COLOUR_RELATION, colour)
            self._add(Entry(words_of(colour), COLOUR_RELATION, text))
        for name, tail in self._pairs(heads):
            self._learn(name, tail)
            for kind in self._classes(tail):
                self._learn(name, kind)  # "on table" of what is on table_4
            for inner, end in self._pairs([tail]):
                if inner not in self.denials and name not in self.denials:
                    self._learn(name, end, inner)
        self.numbers = defaultdict[str, dict[int, float]](dict)
        none = dict.fromkeys(heads, 0.0)
        self.counts = defaultdict[str, dict[int, float]](none.copy)
        for head, relation, tail in self._facts(heads):
            name = graph.relation_names.short(relation)
            self.counts[name][head] += 1
            text = local_name(graph.names[tail])
            if re.fullmatch(r"\d+(\.\d+)?", text):
                self.numbers[name][head] = float(text)

    def _classes(self, tail: int) -> list[int]:
        """Return the classes of an individual that a relation leads to; none of a class."""
        is_literal = self.graph.names[tail].startswith('"')
        if is_literal or is_class(self.graph, tail):
            return []
        return classes_of(self.graph, tail)

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
        pairs = {(relation, tail) for _, relation, tail in self._facts(heads)}
        for relation, tail in sorted(pairs):
            yield self._relation(relation), tail

    def _relation(self, relation: int) -> str:
        """Return the name of a relation, whose words are learned.

        A relation that denies is said by those of its words alone that turn its sense, if any:
        ``unsafeFor`` by "unsafe"; what it denies is asked of the relation that affirms it.
        """
        names = self.graph.relation_names
        name = names.short(relation)
        if name in self.words:
            return name
        self._said.clear()
        words = words_of(self._label(names[relation]))
        self.words[name] = words
        turning = negative_words(words)
        turned = stance(names[relation], self.graph.labels.get(names[relation], ""))
        if turned.denies or turning:
            self.denials[name] = turning.difference(_NEGATIONS, WORDS["negations"])
        if turned.denies and turned.subject:
            self.affirming[name] = self._affirming(relation, words, turned)
        return name

    def _affirming(self, relation: int, words: Sequence[str], turned: Stance) -> str:
        """Return the name of the relation that affirms what another one denies: ``usedFor``."""
        names = self.graph.relation_names
        for other in opposed(self.graph, names[relation]):
            return self._relation(other)
        by_key = dict(zip(map(name_key, words), words, strict=True))
        affirming = []
        if words[0] == "is":
            affirming.append("is")
        for key in turned.subject:
            by_key.setdefault(key, key)
        affirming += map(by_key.__getitem__, turned.subject)
        name = affirming[0] + "".join(map(str.capitalize, affirming[1:]))
        self.words.setdefault(name, tuple(affirming))
        return name

    def _learn(self, relation: str, tail: int, inner: str = "") -> None:
        """Learn the condition of one relation, or of two: "usedFor (relatedTo tea)"."""
        if relation in self.affirming and not inner:
            self._learn(self.affirming[relation], tail)
        if relation in self.denials and not self.denials[relation]:
            return
        names = self.graph.names
        words = words_of(self._label(names[tail]))
        if is_colour(relation) and (
            inner or name_key(" ".join(words)) in self._colours
        ):
            return  # the image shows it
        value = local_name(names[tail])
        text = condition(relation, value)
        if self._has_many_kinds and self.family(relation) is FAMILIES["type"]:
            text = f"{IS} {quoted(value)}"  # whichever of its relations says so
        if inner:
            text = f"{quoted(relation)} ({condition(inner, value)})"
        entry = Entry(words, relation, text, inner)
        self._add(entry)
        if inner:
            return
        for role, other_words in self._roles(words, self.family(relation)):
            self._add(entry._replace(words=other_words, role=role))

    def _roles(
        self, words: tuple[str, ...], family: Family
    ) -> Iterator[tuple[str, tuple[str, ...]]]:
        """Yield how else a value is said: HAS_SWITCH by "switch", CAN_OPEN by "open"."""
        if len(words) > 1 and words[0] == "can":
            yield "verb", words[1:]
        if len(words) > 1 and words[0] in _HAVE:
            yield "part", words[1:]
        if len(words) > 1 and words[0] == "is":
            yield "", words[1:]
        if family is FAMILIES["ability"]:
            yield "verb", words
        if len(words) > 1 and family is FAMILIES["part"]:
            yield "head", words[-1:]  # a "light bulb" is a bulb
        for word in words[-1:]:
            for verb in sorted(verbs_of(word)):
                yield "verb", (*words[:-1], verb)

    def _add(self, entry: Entry) -> None:
        """Add a condition and index it by the first word of its value."""
        if not entry.words or entry in self.entries:
            return
        self.entries[entry] = None
        first = entry.words[0]
        self._by_first[first].append(entry)
        self._by_form[name_key(first)].add(first)
        for form in forms_of(first):
            self._by_form[form].add(first)

    def starting(self, word: str) -> Iterator[Entry]:
        """Yield the conditions whose value may begin with a word."""
        firsts = set[str]()
        for form in related(word):
            firsts.update(self._by_form.get(form, ()))
        return chain.from_iterable(map(self._by_first.__getitem__, sorted(firsts)))

    def look_up(self, words: Sequence[str]) -> None:
        """Learn what the whole graph states of a value that no object has."""
        graph = self.graph
        known = len(self.entries)
        texts = [" ".join(words)]
        if len(words) == 1:
            texts += forms_of(words[0])
            texts += synonyms_of(words[0])
            texts.append(f"{words[0]}ing")
        ids = set(chain.from_iterable(map(graph.alike, texts)))
        for tail in sorted(ids):
            rows = graph.in_rows(tail)
            for relation in np.unique(graph.relations[rows]).tolist():
                name = self._relation(relation)
                if name not in self.denials:
                    self._learn(name, tail)
        self.elsewhere.update(islice(self.entries, known, None))

    def family(self, relation: str) -> Family:
        """Return the family of a relation."""
        if relation not in self._families:
            self._families[relation] = self._family(relation)
        return self._families[relation]

    def _family(self, relation: str) -> Family:
        if relation in self.denials:
            return Family()
        name = " ".join(self.words.get(relation, ()))
        for family in FAMILIES.values():
            if family.relations and re.search(family.relations, name):
                return family
        return Family()

    def of_family(self, name: str) -> set[str]:
        """Return the relations of a family."""
        return {word for word in self.words if self.family(word) is FAMILIES[name]}

    def said(self, word: str) -> frozenset[str]:
        """Return the relations that a word says: with its own word, or with one of its family."""
        if word not in self._said:
            relations = set(filter(lambda name: self._says(word, name), self.words))
            named = relations & set(chain.from_iterable(self._broader.values()))
            if len(relations) > 1 and named:  # "stored in" of storedIn and locatedIn
                relations -= {name for name in named if not self._names(word, name)}
            if not relations:
                for name in self.words:
                    if near(word, self.family(name).otherwise, INFLECTED):
                        relations.add(name)
            self._said[word] = frozenset(relations)
        return self._said[word]

    def _says(self, word: str, relation: str) -> bool:
        if relation in self.denials:
            return near(word, self.denials[relation], 0)
        is_strong = near(word, self.family(relation).strong, INFLECTED)
        return is_strong or self._names(word, relation)

    def _names(self, word: str, relation: str) -> bool:
        """Return whether a word is one of a relation's own."""
        words = set(self.words[relation]) - _EMPTY
        return any(near(form, words, DERIVED) for form in (word, *verbs_of(word)))

    def is_implied(self, relation: str) -> bool:
        """Return whether a broader relation of the graph says the same: locatedIn of storedIn."""
        return bool(self._broader[relation])

    def noun(self, word: str, counted: bool = False) -> str:
        """Return the relation whose values a word counts, as "parts" those of hasPart, or "".

        ``counted``: behind a number "use" is a noun; else it may be a verb, as "uses" is not.
        """
        is_use = word in WORDS["uses"] or (counted and word in WORDS["use"])
        for relation, words in self.words.items():
            if relation == COLOUR_RELATION or relation in self.denials or not words:
                continue
            family = self.family(relation)
            is_noun = words[0] in _HAVE or family is FAMILIES["part"]
            is_verb = self.is_verb(relation) and not word.endswith("er")
            if is_noun and near(word, words[-1:], 0):
                return relation
            if is_verb and near(word, words, INFLECTED):
                return relation
            if is_use and family in (FAMILIES["use"], FAMILIES["ability"]):
                return relation
        return ""

    def is_verb(self, relation: str) -> bool:
        """Return whether a relation may be a verb alone, as ``burns`` in "something that burns"."""
        is_word = len(self.words[relation]) == 1
        return is_word and relation not in self.numbers

    def prepositions(self, relation: str) -> set[str]:
        """Return the prepositions and forms of "have" that may precede values of a relation."""
        words = set(self.words.get(relation, ()))
        family = self.family(relation)
        if family.relations or words <= _EMPTY:
            return words.union(family.weak)
        return set()  # what is "for children" need not be safe for them

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

    def nearest(self, words: Collection[str], asked: str = "") -> str:
        """Return a sentence with the conditions whose values are nearest to words, but for one."""
        texts = []
        examples: dict[str, str] = {}
        colours = []
        for entry in self.entries:
            if any(near(word, entry.words, SYNONYM) for word in words):
                texts.append(entry.text)
            if not entry.inner and entry.relation != IS:
                examples.setdefault(entry.relation, entry.text)
            if entry.relation == COLOUR_RELATION:
                colours.append(entry.text)
        others = [word for word in words if not self._is_near(word)]
        texts += self._alike_in_meaning(others)
        if not texts and any(COLOUR_RELATION in self.said(word) for word in words):
            texts = colours
        if set(texts) - {asked}:
            texts = [text for text in dict.fromkeys(texts) if text != asked]
            texts = texts[:MOST_HINTS]
            return f"Nearest: {'; '.join(texts)}."
        return f"It can be asked for, among others: {'; '.join(list(examples.values())[:6])}."

    def _is_near(self, word: str) -> bool:
        """Return whether a word is one of a value, or a synonym."""
        return any(near(word, entry.words, SYNONYM) for entry in self.starting(word))

    def _alike_in_meaning(self, words: Iterable[str]) -> list[str]:
        """Return the conditions whose values are nearest to words by the shipped vectors."""
        table = shipped_vectors("wordnet-gloss-50")
        wanted = [table.index[word] for word in words if word in table.index]
        texts = []
        rows = []
        for entry in self.entries:
            last = entry.words[-1]
            if not entry.inner and last in table.index:
                texts.append(entry.text)
                rows.append(table.index[last])
        if not wanted or not rows:
            return []
        vectors = table.vectors / np.linalg.norm(table.vectors, axis=1, keepdims=True)
        cosines = (vectors[rows] @ vectors[wanted].T).max(1)
        order = np.argsort(-cosines, kind="stable")
        return [texts[i] for i in order[:3] if cosines[i] >= NEAR_HINT]


def _broader_relations(graph: KnowledgeGraph) -> defaultdict[str, set[str]]:
    """Return the relations of which each is a subproperty, by its name."""
    broader = defaultdict[str, set[str]](set)
    names = graph.relation_names
    subproperty = names.find(RDFS + "subPropertyOf")
    for row in np.flatnonzero(graph.relations == subproperty).tolist():
        head = names.find(graph.names[graph.heads[row]])
        tail = names.find(graph.names[graph.tails[row]])
        if head is not None and tail is not None and head != tail:
            broader[names.short(head)].add(names.short(tail))
    return broader


def words_of(label: str) -> tuple[str, ...]:
    """Return the words of a name or label in lower case."""
    label = re.sub(r"^/(?:c/\w+|r)/([^/]+).*", r"\1", label)  # of ConceptNet
    return tuple(re.findall(r"[^\W_]+(?:\.\d+)?", spaced(label).casefold()))
