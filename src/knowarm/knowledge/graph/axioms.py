"""Axioms of a graph, encoded as triples for rules: restrictions, lists, chains, negations."""

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from itertools import permutations

import numpy as np

from knowarm.knowledge.graph.denials import denial
from knowarm.knowledge.graph.graph import KnowledgeGraph, Triple
from knowarm.knowledge.graph.owl import FRESH, NOT_A, WORDS
from knowarm.knowledge.graph.terms import parse_literal

_MOST_MEMBERS = 300
"""Most members of a list of which each excludes all others."""
_Numbers = Mapping[str, range | None]
"""Kinds of restrictions, and the numbers with which they count; None without a number."""
_SURELY: _Numbers = {
    "someValuesFrom": None,
    "hasValue": None,
}
_FROM_ONE = range(1, 10**9)
_SOME: _Numbers = {
    **_SURELY,
    "qualifiedCardinality": _FROM_ONE,
    "minQualifiedCardinality": _FROM_ONE,
}
"""Of their values one or more are demanded."""
_ENOUGH: _Numbers = {
    **_SURELY,
    "minQualifiedCardinality": range(1, 2),
}
"""Of their values one is enough."""
_NONE: _Numbers = {
    "qualifiedCardinality": range(1),
    "maxQualifiedCardinality": range(1),
}
"""Of their values none is allowed."""
_MEMBERS = {
    "unionOf": "subClassOf",
    "disjointUnionOf": "subClassOf",
    "oneOf": "type",
}
"""What puts the members of a list into the class."""
_NOT_USED = (
    "minCardinality",
    "maxCardinality",
    "cardinality",
    "hasSelf",
    "hasKey",
    "onDataRange",
)
_NOT_USED_TYPES = (
    "FunctionalProperty",
    "InverseFunctionalProperty",
)
_PROPERTY_TYPES = (
    "SymmetricProperty",
    "TransitiveProperty",
    *_NOT_USED_TYPES,
)
_SUBJECTS = (
    "subPropertyOf equivalentProperty inverseOf propertyDisjointWith domain range "
    "propertyChainAxiom"
)
_OBJECTS = (
    "subPropertyOf equivalentProperty inverseOf propertyDisjointWith onProperty "
    "assertionProperty"
)
"""Words whose subjects or objects are relations."""
_Row = tuple[str, int]
"""A name, and the row of the graph that states it."""


def general(relation: str) -> str:
    """Return the relation for what restrictions on a relation state of classes."""
    return f"{FRESH}general {relation}"


def denied(relation: str) -> str:
    """Return the relation for what axioms deny of all members of a class."""
    return f"{FRESH}denied {relation}"


def makes(relation: str) -> str:
    """Return the relation from a class to the restrictions that it fills."""
    return f"{FRESH}makes {relation}"


class Axioms:
    """The axioms of a graph, encoded for the rules.

    Attributes:
        encoded: the rows that state each triple of names in the relations of the rules.
        properties: the names of all relations that axioms speak of.
        plain: the relation that a graph has, by the one that the rules have for it.
        unused: how many axioms of which kind state nothing here.
    """

    def __init__(self, graph: KnowledgeGraph) -> None:
        self.graph = graph
        self.encoded = dict[Triple, tuple[int, ...]]()
        self.unused = Counter[str]()
        self.of = cache(self._find)
        self._probabilities = graph.probabilities(np.arange(len(graph)))
        self.properties = self._properties()
        self._chains()
        self._classes()
        self._restrictions()
        self._exclusions()
        self.plain = {WORDS["excludes"]: NOT_A[1]}
        self._relations()
        for word in _NOT_USED:
            self.unused += Counter({word: len(self.of(word))})
        for word in _NOT_USED_TYPES:
            self.unused += Counter({word: len(self._of_type(word))})

    def _find(self, word: str) -> dict[str, list[_Row]]:
        """Return the tails of a relation by head."""
        graph = self.graph
        tails: dict[str, list[_Row]] = defaultdict(list)
        for relation in graph.relation_names.find_all([WORDS[word]]):
            for row in np.flatnonzero(graph.relations == relation).tolist():
                tail = graph.names[graph.tails[row]]
                tails[graph.names[graph.heads[row]]].append((tail, row))
        return tails

    def _pairs(self, word: str) -> Iterator[tuple[str, str, int]]:
        """Yield head, tail and row of each triple of a relation."""
        for head, tails in self.of(word).items():
            for tail, row in tails:
                yield head, tail, row

    def _lists(self, word: str) -> Iterator[tuple[str, list[str], int]]:
        """Yield head, members of the list and row of each triple of a relation to lists."""
        for head, rest, row in self._pairs(word):
            yield head, self._members(rest), row

    def _members(self, rest: str) -> list[str]:
        """Return the members of an RDF list."""
        first = self.of("first")
        members = dict[str, str]()
        while rest in first and rest not in members:
            members[rest] = first[rest][0][0]
            rest = self.of("rest").get(rest, [("", 0)])[0][0]
        return list(members.values())

    def _of_type(self, word: str) -> dict[str, int]:
        """Return the rows that state what is of a type of OWL, by its name."""
        graph = self.graph
        rows = {}
        for entity in graph.names.find_all([WORDS[word]]):
            for row in graph.in_rows(entity).tolist():
                if graph.relation_names[graph.relations[row]] == WORDS["type"]:
                    rows[graph.names[graph.heads[row]]] = row
        return rows

    def _add(self, head: str, word: str, tail: str, *rows: int) -> None:
        """Encode a triple with the surest rows that state it."""
        triple = (head, WORDS.get(word, word), tail)
        known = self.encoded.setdefault(triple, rows)
        if self.sure(rows) > self.sure(known):
            self.encoded[triple] = rows

    def sure(self, rows: Sequence[int]) -> float:
        """Return the probability that all of some rows hold."""
        return float(self._probabilities[list(rows)].prod())

    def _properties(self) -> set[str]:
        properties = set[str]()
        for word in _SUBJECTS.split():
            properties.update(self.of(word))
        for word in _OBJECTS.split():
            properties.update(tail for _, tail, _ in self._pairs(word))
        for word in _PROPERTY_TYPES:
            properties.update(self._of_type(word))
        return {name for name in properties if not name.startswith('"')}

    def _chains(self) -> None:
        """Encode transitive relations, and chains of two relations each."""
        for name, row in self._of_type("TransitiveProperty").items():
            self._add(name, "transitive", name, row)
            self._add(general(name), "transitive", general(name), row)
            self._join(name, general(name), general(name), row)
        for name, steps, row in self._lists("propertyChainAxiom"):
            self.properties.update(steps)
            for first, second, result in _folded(steps, name, row):
                self.properties.add(result)
                self._join(first, second, result, row)
                # x is in y, and all y are in some z
                self._join(first, general(second), general(result), row)
                self._join(general(first), general(second), general(result), row)

    def _join(self, first: str, second: str, result: str, row: int) -> None:
        self._add(first, f"{FRESH}chain {result}", second, row)
        self._add(f"{FRESH}chain {result}", "result", result, row)

    def _classes(self) -> None:
        """Encode intersections, unions and enumerations."""
        for name, members, row in self._lists("intersectionOf"):
            for member in members:
                self._add(name, "subClassOf", member, row)
            for left, right, result in _folded(members, name, row):
                self._add(result, "left", left, row)
                self._add(result, "right", right, row)
        for word, relation in _MEMBERS.items():
            for name, members, row in self._lists(word):
                for member in members:
                    self._add(member, relation, name, row)

    def _restrictions(self) -> None:
        """Encode what each restriction says of its members."""
        for name, relation, row in self._pairs("onProperty"):
            said = False
            for value, value_row in self._values(name, _ENOUGH):
                self._add(value, makes(relation), name, row, value_row)
                if value == WORDS["Thing"]:
                    self._add(relation, "domain", name, row, value_row)
            for value, value_row in self._values(name, _SOME):
                if relation.startswith("_:"):
                    continue
                named = self._named(value)
                said |= bool(named)
                for part in named or [value]:
                    self._add(name, general(relation), part, row, value_row)
            for value, value_row in self._values(name, _NONE):
                said = True
                if not value.startswith("_:"):
                    self._add(name, denied(relation), value, row, value_row)
            kinds = [
                word for word in (*_SURELY, *_NONE, *_SOME) if name in self.of(word)
            ]
            if not said:
                self.unused.update(kinds[:1])

    def _values(self, name: str, kinds: _Numbers) -> Iterator[_Row]:
        """Yield the classes and individuals that a restriction of some kinds speaks of."""
        for word, numbers in kinds.items():
            for value, row in self.of(word).get(name, []):
                if numbers is None:
                    yield value, row
                elif _number(value) in numbers:
                    yield from self.of("onClass").get(name, [])

    def _named(self, name: str) -> list[str]:
        """Return the named classes of an anonymous intersection, or the name itself."""
        parts = [name]
        seen = {name}
        for part in parts:
            if part.startswith("_:"):
                for rest, _ in self.of("intersectionOf").get(part, [])[:1]:
                    new = [
                        member for member in self._members(rest) if member not in seen
                    ]
                    parts += new
                    seen.update(new)
        return [part for part in parts if not part.startswith("_:")]

    def _exclusions(self) -> None:
        """Encode which classes and relations exclude each other."""
        for word in ("disjointWith", "complementOf"):
            for name, other, row in self._pairs(word):
                self._exclude([name, other], row)
        for _, members, row in self._lists("disjointUnionOf"):
            self._exclude(members, row, "disjointUnionOf")
        types = ("AllDisjointClasses", "AllDisjointProperties")
        classes, properties = map(self._of_type, types)
        for name, members, _ in self._lists("members"):
            if name in classes:
                self._exclude(members, classes[name], types[0])
            if name in properties:
                members = members[:_MOST_MEMBERS]
                self.properties.update(members)
                for first, second in permutations(members, 2):
                    self._add(first, "propertyDisjointWith", second, properties[name])

    def _exclude(self, classes: list[str], row: int, word: str = "") -> None:
        """Encode that no member of a class is one of another class or restriction."""
        if len(classes) > _MOST_MEMBERS:
            self.unused[f"{word} of {len(classes)}"] += 1
            return
        for name, other in permutations(classes, 2):
            self._add(name, "excludes", other, row)
            for relation, relation_row in self.of("onProperty").get(other, []):
                for value, value_row in self._values(other, _ENOUGH):
                    if not value.startswith("_:"):
                        rows = (row, relation_row, value_row)
                        self._add(name, denied(relation), value, *rows)

    def _relations(self) -> None:
        """Encode which relation states in general what one states, and which deny it."""
        for name in sorted(self.properties):
            self.plain[general(name)] = name
            self.plain[denied(name)] = denial(name)
            if not name.startswith("_:"):
                self._add(name, "general", general(name))
                self._add(general(name), "neededBy", makes(name))
                self._add(name, "denied", denial(name))
                self._add(name, "generallyDenied", denied(name))


def _folded(
    members: list[str], result: str, row: int
) -> Iterator[tuple[str, str, str]]:
    """Yield pairs that make up a list from its begin, and what each pair makes."""
    made = [f"{FRESH}{number} {row}" for number in range(2, len(members))]
    made.append(result)
    return zip([*members[:1], *made], members[1:], made, strict=False)


def _number(name: str) -> int:
    """Return the number of a literal, -1 of others."""
    literal = parse_literal(name)
    if literal is None or not literal.value.isdecimal():
        return -1
    return int(literal.value)
