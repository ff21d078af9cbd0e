"""Vocabulary of a graph: what can be asked about objects, and the English words that say it."""

import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Sequence
from functools import cache
from itertools import chain, islice, repeat
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from numpy.linalg import norm

from knowarm.asking.lexicon import (
    FAMILIES,
    INFLECTED,
    SYNONYM,
    WEAK,
    WORDS,
    forms_of,
    near,
    related,
    spaced,
    synonyms_of,
    verbs_of,
)
from knowarm.asking.quotes import condition, quoted
from knowarm.asking.relations import IS, Relation, is_colour, kind_relations
from knowarm.knowledge.graph.denials import Stance, negative_words, opposed, stance
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.individuals import classes_of_value
from knowarm.knowledge.graph.owl import OWL
from knowarm.knowledge.graph.terms import RDFS, label_of, local_name, name_key
from knowarm.knowledge.vectors.words import shipped_vectors
from knowarm.questions import COLOUR_RELATION

_HAVE = FAMILIES["part"].weak
_ROLES = {"can": "verb", "is": "", **dict.fromkeys(_HAVE, "part")}
"""Roles of a value behind its first word: CAN_OPEN, HAS_SWITCH."""
NEAR_HINT = 0.35
"""Least cosine of the words of a question and of a condition that is offered instead."""
MOST_HINTS = 9


Words = tuple[str, ...]
"""Words in lower case."""


class Entry(NamedTuple):
    """A condition of the graph, and the words of its value."""

    words: Words
    relation: Relation
    text: str
    inner: Relation | None = None  # The second relation of a chain
    role: str = ""  # "verb" of "can open", "part" of "has switch", "head"


class Vocabulary:
    """What can be asked about some entities of a graph.

    Args:
        graph: the graph.
        heads: ids of the entities that questions are about.
        colours: the colours that images show.
        objects: names of the objects.

    Attributes:
        relations: the relations that can be said, by name.
        colour: the one whose values the image shows.
        entries: what can be asked, once each.
        elsewhere: conditions that the graph states of other entities only.
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
        self.colour = Relation(COLOUR_RELATION, ("has", "colour"))
        self.relations = {COLOUR_RELATION: self.colour}
        self.entries: dict[Entry, None] = {}
        self.elsewhere = set[Entry]()
        self._by_form = defaultdict[str, set[str]](set)
        self._by_first = defaultdict[str, list[Entry]](list)
        self._said: dict[str, frozenset[Relation]] = {}
        self._relation = cache(self._named)
        self._narrow, self._broad = _subproperties(graph)
        self._has_many_kinds = sum(map(len, kind_relations(graph))) > 1
        for name in objects:
            self._add(Entry(words_of(name), IS, f"is {quoted(name)}"))
        self._colours = set(map(name_key, colours))
        for colour in colours:
            text = condition(COLOUR_RELATION, colour)
            self._add(Entry(words_of(colour), self.colour, text))
        for relation, tail in self._pairs(heads):
            for value in (tail, *classes_of_value(graph, tail)):
                self._learn(relation, value)  # "on table" of what is on table_4
            for inner, end in self._pairs([tail]):
                if inner.turning is None and relation.turning is None:
                    self._learn(relation, end, inner)
        for head, index, tail in self._facts(heads):
            relation = self._relation(index)
            text = local_name(graph.names[tail])
            if re.fullmatch(r"\d+(\.\d+)?", text):
                relation.numbers[head] = float(text)

    def _label(self, name: str) -> str:
        labels = self.graph.labels
        if name.startswith("/") and name not in labels:  # of ConceptNet
            return name
        return label_of(name, labels)

    def _facts(self, heads: Collection[int]) -> Iterator[tuple[int, int, int]]:
        """Yield the triples whose heads are some entities."""
        graph = self.graph
        for head in heads:
            rows = graph.out_rows(head)
            relations = graph.relations[rows].tolist()
            tails = graph.tails[rows].tolist()
            yield from zip(repeat(head), relations, tails, strict=False)

    def _pairs(self, heads: Collection[int]) -> Iterator[tuple[Relation, int]]:
        """Yield the relations of entities and what they lead to."""
        pairs = set(map(itemgetter(1, 2), self._facts(heads)))
        for relation, tail in sorted(pairs):
            if not self._is_axiom(relation):
                yield self._relation(relation), tail

    def _is_axiom(self, relation: int) -> bool:
        """Return whether a relation is of OWL, as ``onProperty``: nothing that people say."""
        return self.graph.relation_names[relation].startswith(OWL)

    def _named(self, index: int) -> Relation:
        """Return a relation, which can be said from now on.

        A relation that denies is said by those of its words alone that turn its sense, if any:
        ``unsafeFor`` by "unsafe"; what it denies is asked of the relation that affirms it.
        """
        names = self.graph.relation_names
        name = names.short(index)
        if name in self.relations:
            return self.relations[name]
        words = words_of(self._label(names[index]))
        turned = stance(names[index], self.graph.labels.get(names[index], ""))
        turning = negative_words(words)
        turning_words = None
        if turned.denies or turning:
            turning_words = frozenset(turning - WORDS.denying - WORDS.negations)
        affirming = None
        if turned.denies and turned.subject:
            affirming = self._affirming(index, words, turned)
        is_narrow = name in self._narrow
        return self._say(Relation(name, words, turning_words, affirming, is_narrow))

    def _say(self, relation: Relation) -> Relation:
        """Return the relation of this name, which can be said from now on."""
        self._said.clear()
        return self.relations.setdefault(relation.name, relation)

    def _affirming(self, index: int, words: Sequence[str], turned: Stance) -> Relation:
        """Return the relation that affirms what another one denies: ``usedFor``."""
        for other in opposed(self.graph, self.graph.relation_names[index]):
            return self._relation(other)
        by_key = {}
        for word in words:
            subject, denies = stance(word)
            if len(subject) == 1 and not denies:
                by_key[subject[0]] = word
        affirming = [by_key.get(key, key) for key in turned.subject]
        if words[0] == "is" and affirming[0] != "has":
            affirming.insert(0, "is")
        first, *others = affirming
        name = first + "".join(map(str.capitalize, others))
        return self._say(Relation(name, tuple(affirming), is_narrow=True))

    def _learn(
        self, relation: Relation, tail: int, inner: Relation | None = None
    ) -> None:
        """Learn the condition of one relation, or of two: "usedFor (relatedTo tea)"."""
        if relation.affirming and not inner:
            self._learn(relation.affirming, tail)
        if relation.turning is not None and not relation.turning:
            return
        names = self.graph.names
        words = words_of(self._label(names[tail]))
        is_seen = is_colour(relation.name)
        if is_seen and (inner or name_key(" ".join(words)) in self._colours):
            return  # the image shows it
        value = local_name(names[tail])
        text = condition(relation.name, value)
        if self._has_many_kinds and relation.family is FAMILIES["type"]:
            text = f"is {quoted(value)}"  # whichever of its relations says so
        if inner:
            text = f"{quoted(relation.name)} ({condition(inner.name, value)})"
        entry = Entry(words, relation, text, inner)
        self._add(entry)
        if not inner:
            for role, other_words in self._roles(entry, tail):
                self._add(entry._replace(words=other_words, role=role))

    def _roles(self, entry: Entry, tail: int) -> Iterator[tuple[str, Words]]:
        """Yield how else a value is said: HAS_SWITCH by "switch", CAN_OPEN by "open"."""
        words = entry.words
        is_numbered = len(words) > 1 and words[-1].isdecimal()
        if is_numbered and not classes_of_value(self.graph, tail):
            yield "", words[:-1]  # "on the table" of what is on table_3
        family = entry.relation.family
        if len(words) > 1 and words[0] in _ROLES:
            yield _ROLES[words[0]], words[1:]
        if family is FAMILIES["ability"]:
            yield "verb", words
        if len(words) > 1 and family is FAMILIES["part"]:
            yield "head", words[-1:]  # a "light bulb" is a bulb
        if family is FAMILIES["type"] and WEAK.isdisjoint(words):
            for start in range(1, len(words)):
                yield "kind", words[start:]  # a "kitchen appliance" is an appliance
        for word in words[-1:]:
            for verb in sorted(verbs_of(word)):
                yield "verb", (*words[:-1], verb)

    def _add(self, entry: Entry) -> None:
        """Add a condition and index it by the first word of its value."""
        if not entry.words:
            return
        if entry in self.entries:
            return
        self.entries[entry] = None
        first = entry.words[0]
        self._by_first[first].append(entry)
        for form in (name_key(first), *forms_of(first)):
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
            (word,) = words
            texts += forms_of(word)
            texts += synonyms_of(word)
            texts.append(f"{word}ing")
        ids = set(chain.from_iterable(map(graph.alike, texts)))
        for tail in sorted(ids):
            rows = graph.in_rows(tail)
            for relation in np.unique(graph.relations[rows]).tolist():
                stating = self._relation(relation)
                if stating.turning is None and not self._is_axiom(relation):
                    self._learn(stating, tail)
        self.elsewhere.update(islice(self.entries, known, None))

    def said(self, word: str) -> frozenset[Relation]:
        """Return the relations that a word says: with its own word, or with one of its family."""
        if word not in self._said:
            known = self.relations.values()
            relations = {relation for relation in known if relation.is_said_by(word)}
            if len(relations) > 1:  # "stored in" of storedIn and locatedIn
                for relation in relations.copy():
                    if relation.name in self._broad and not relation.is_named_by(word):
                        relations.remove(relation)
            if not relations:
                for relation in known:
                    if near(word, relation.family.otherwise, INFLECTED):
                        relations.add(relation)
            self._said[word] = frozenset(relations)
        return self._said[word]

    def noun(self, word: str, counted: bool = False) -> Relation | None:
        """Return the relation whose values a word counts, as "parts" those of hasPart.

        ``counted``: behind a number "use" is a noun; else it may be a verb, as "uses" is not.
        """
        is_use = word in WORDS.uses or (counted and word in WORDS.use)
        for relation in self.relations.values():
            words = relation.words
            if relation == self.colour:
                continue
            if not words:
                continue
            if relation.turning is not None:
                continue
            family = relation.family
            is_noun = words[0] in _HAVE or family is FAMILIES["part"]
            is_verb = relation.is_verb and not word.endswith("er")
            if (
                (is_noun and near(word, words[-1:], 0))
                or (is_verb and near(word, words, INFLECTED))
                or (is_use and family in (FAMILIES["use"], FAMILIES["ability"]))
            ):
                return relation
        return None

    def measured(self, word: str) -> tuple[Relation | None, str]:
        """Return the relation of numbers that an adjective is about, and ">" or "<"."""
        for relation in self.relations.values():
            if not relation.numbers:
                continue
            if near(word, relation.family.large, INFLECTED):
                return relation, ">"
            if near(word, relation.family.small, INFLECTED):
                return relation, "<"
        return None, ""

    def nearest(self, words: Collection[str], asked: str = "") -> str:
        """Return a sentence with the conditions whose values are nearest to words, but for one."""
        texts: dict[str, None] = {}
        near_words = set()
        examples: dict[Relation, str] = {}
        colours = []
        for entry in self.entries:
            for word in words:
                if near(word, entry.words, SYNONYM):
                    near_words.add(word)
                    texts[entry.text] = None
            if not entry.inner and entry.relation != IS:
                examples.setdefault(entry.relation, entry.text)
            if entry.relation == self.colour:
                colours.append(entry.text)
        texts |= dict.fromkeys(self._alike_in_meaning(set(words) - near_words))
        said = chain.from_iterable(map(self.said, words))
        if not texts and self.colour in said:
            texts = dict.fromkeys(colours)
        texts.pop(asked, None)
        if texts:
            nearest = islice(texts, MOST_HINTS)
            return f"Nearest: {'; '.join(nearest)}."
        others = islice(examples.values(), 6)
        return f"It can be asked for, among others: {'; '.join(others)}."

    def _alike_in_meaning(self, words: Iterable[str]) -> list[str]:
        """Return the conditions whose values are nearest to words by the shipped vectors."""
        table = shipped_vectors("wordnet-gloss-50")
        wanted = [table.index[word] for word in words if word in table.index]
        if not wanted:
            return []
        texts = []
        rows = []
        for entry in self.entries:
            last = entry.words[-1]
            if not entry.inner and last in table.index:
                texts.append(entry.text)
                rows.append(table.index[last])
        if not rows:
            return []
        lengths = norm(table.vectors, axis=1, keepdims=True)
        vectors = table.vectors / lengths
        cosines = vectors[rows] @ vectors[wanted].T
        largest = cosines.max(1)
        order = np.argsort(-largest, kind="stable")
        return [texts[i] for i in order[:3] if largest[i] >= NEAR_HINT]


def _subproperties(graph: KnowledgeGraph) -> tuple[set[str], set[str]]:
    """Return the relations that are subproperties of others, and those others, by name."""
    narrow = set()
    broad = set()
    names = graph.relation_names
    subproperty = names.find(RDFS + "subPropertyOf")
    for triple in graph.rows(graph.relations == subproperty):
        head = names.find(triple[0])
        tail = names.find(triple[2])
        if head is not None and tail is not None and head != tail:
            narrow.add(names.short(head))
            broad.add(names.short(tail))
    return narrow, broad


@cache
def words_of(label: str) -> Words:
    """Return the words of a name or label in lower case."""
    label = re.sub(r"(?<=\w)\.[nvasr]\.\d+$", "", label)  # of WordNet
    label = re.sub(r"^/(?:c/\w+|r)/([^/]+).*", r"\1", label)  # of ConceptNet
    return tuple(re.findall(r"[^\W_]+(?:\.\d+)?", spaced(label).casefold()))
