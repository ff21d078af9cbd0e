"""Relations of a graph as English speaks of them, and those of kinds and colours."""

import re
from dataclasses import dataclass, field
from functools import cached_property

from knowarm.asking.lexicon import (
    BESIDE,
    DERIVED,
    EXTREMES,
    FAMILIES,
    INFLECTED,
    WEAK,
    WORDS,
    Family,
    near,
    tokens,
    verbs_of,
)
from knowarm.knowledge.graph.denials import opposed, stance
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.terms import RDF_TYPE, RDFS, label_of, name_key
from knowarm.questions import COLOUR_RELATION

_COLOURS = (name_key(COLOUR_RELATION), name_key("hasColour"))
_EMPTY = WEAK | WORDS.empty


@dataclass(frozen=True, eq=False)
class Relation:
    """A relation of a graph, and the English that says it; of a vocabulary, each is one object."""

    name: str
    words: tuple[str, ...] = ()
    """The words of its name or label."""
    turning: frozenset[str] | None = None
    """Of a relation whose name negates, the words that do so and say it: "unsafe"."""
    affirming: "Relation | None" = None
    """Of a relation that denies, the one that affirms the same."""
    is_narrow: bool = False
    """Whether a broader relation of the graph says the same, as locatedIn of storedIn, or the graph
    states nothing by it: suitableFor of notSuitableFor."""
    numbers: dict[int, float] = field(default_factory=dict)
    """The numbers that it states, by entity."""

    @cached_property
    def family(self) -> Family:
        """What it means alike in any graph."""
        name = " ".join(self.words)
        for family in FAMILIES.values():
            if self.turning is None and re.search(family.relations, name):
                return family
        return Family()

    @property
    def is_verb(self) -> bool:
        """Whether it may be a verb alone, as ``burns`` in "something that burns"."""
        return len(self.words) == 1 and not self.numbers

    @cached_property
    def prepositions(self) -> set[str]:
        """The prepositions and forms of "have" that may precede its values."""
        if self.family.relations or _EMPTY.issuperset(self.words):
            return {*self.words, *self.family.weak}
        return set()  # what is "for children" need not be safe for them

    def is_said_by(self, word: str) -> bool:
        """Return whether a word says it: one of its own, or of its family."""
        if self.turning is not None:
            return near(word, self.turning, 0)
        return near(word, self.family.strong, INFLECTED) or self.is_named_by(word)

    def is_named_by(self, word: str) -> bool:
        """Return whether a word is one of its own, or its name: "nearestto" of nextTo."""
        if word in BESIDE:
            return tokens(self.name.replace("_", " "))[-1:] == [word]
        words = set(self.words) - _EMPTY
        return any(near(form, words, DERIVED) for form in (word, *verbs_of(word)))


NO_RELATION = Relation("")
IS = Relation("is")
"""What stands in place of a relation before the name of an object."""
PLACES = {name: Relation(name) for name in (*EXTREMES.values(), *BESIDE.values())}
"""What stands in place of a relation in conditions on places in the image, by its name."""


def kind_relations(graph: KnowledgeGraph) -> tuple[list[int], list[int]]:
    """Return the ids of the relations that state kinds, and of those that deny them, ascending."""
    labels = graph.labels
    stating = []
    denying = {*opposed(graph, RDF_TYPE), *opposed(graph, RDFS + "subClassOf")}
    for index, name in enumerate(graph.relation_names):
        is_kind = re.search(FAMILIES["type"].relations, label_of(name, labels))
        if is_kind and not stance(name, labels.get(name, "")).denies:
            stating.append(index)
            denying.update(opposed(graph, name))
    return stating, sorted(denying)


def is_colour(relation: str) -> bool:
    """Return whether the last part of a relation's name is that of colours, in any spelling."""
    return name_key(relation) in _COLOURS
