"""Axioms of a graph, encoded as triples for rules: restrictions, lists, chains, negations."""

from collections import Counter, defaultdict
from collections.abc import Iterator
from itertools import permutations

import numpy as np

from knowarm.knowledge.graph.denials import denial
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.owl import FRESH, WORDS
from knowarm.knowledge.graph.terms import parse_literal

_MOST_MEMBERS = 300
"""Most members of a list of which each excludes all others."""
_POSITIVE = ("someValuesFrom", "hasValue")
_COUNTS = ("qualifiedCardinality", "minQualifiedCardinality")
_NONE = ("qualifiedCardinality", "maxQualifiedCardinality")
_NOT_USED = (
    "minCardinality",
    "maxCardinality",
    "cardinality",
    "hasSelf",
    "hasKey",
    "onDataRange",
)
_Rows = tuple[int, ...]
"""Rows of the graph that state something."""
_Stated = dict[str, list[tuple[str, int]]]
"""Tails of one relation and their rows, by head."""


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
        encoded: triples of names in the relations of the rules, and the rows that state each.
        properties: the names of all relations that axioms speak of.
        unused: how many axioms of which kind state nothing here.
    """

    def __init__(self, graph: KnowledgeGraph) -> None:
        self.graph = graph
        self.encoded = list[tuple[str, str, str, _Rows]]()
        self.unused = Counter[str]()
        self._stated: dict[str, _Stated] = {}
        self.properties = self._properties()
        self._chains()
        self._classes()
        self._restrictions()
        self._exclusions()
        self._relations()
        for word in _NOT_USED:
            if self.of(word):
                self.unused[word] += len(self.of(word))

    def of(self, word: str) -> _Stated:
        """Return the tails of a relation by head."""
        if word not in self._stated:
            graph = self.graph
            stated: _Stated = defaultdict(list)
            relation = graph.relation_names.find(WORDS[word])
            if relation is not None:
                for row in np.flatnonzero(graph.relations == relation).tolist():
                    tail = graph.names[graph.tails[row]]
                    stated[graph.names[graph.heads[row]]].append((tail, row))
            self._stated[word] = stated
        return self._stated[word]

    def pairs(self, word: str) -> Iterator[tuple[str, str, int]]:
        """Yield head, tail and row of each triple of a relation."""
        for head, tails in self.of(word).items():
            for tail, row in tails:
                yield head, tail, row

    def _of_type(self, word: str) -> Iterator[tuple[str, int]]:
        """Yield what is of a type of OWL, and the rows that state it."""
        graph = self.graph
        entity = graph.names.find(WORDS[word])
        relation = graph.relation_names.find(WORDS["type"])
        if entity is None or relation is None:
            return
        for row in graph.in_rows(entity).tolist():
            if graph.relations[row] == relation:
                yield graph.names[graph.heads[row]], row

    def _add(self, head: str, word: str, tail: str, *rows: int) -> None:
        self.encoded.append((head, WORDS.get(word, word), tail, rows))

    def _properties(self) -> set[str]:
        properties = set[str]()
        for word in (
            "subPropertyOf",
            "equivalentProperty",
            "inverseOf",
            "propertyDisjointWith",
        ):
            for head, tail, _ in self.pairs(word):
                properties.update((head, tail))
        for word in ("onProperty", "assertionProperty"):
            for _, tail, _ in self.pairs(word):
                properties.add(tail)
        for word in ("domain", "range", "propertyChainAxiom"):
            properties.update(self.of(word))
        for word in ("SymmetricProperty", "TransitiveProperty"):
            for name, _ in self._of_type(word):
                properties.add(name)
        for word in ("FunctionalProperty", "InverseFunctionalProperty"):
            for name, _ in self._of_type(word):
                properties.add(name)
                self.unused[word] += 1
        for name in list(properties):
            if name.startswith('"'):
                properties.remove(name)
        return properties

    def items(self, rest: str) -> list[str]:
        """Return the members of an RDF list."""
        members = list[str]()
        first = self.of("first")
        seen = set[str]()
        while rest in first and rest not in seen:
            seen.add(rest)
            members.append(first[rest][0][0])
            after = self.of("rest").get(rest)
            rest = after[0][0] if after else ""
        return members

    def _chains(self) -> None:
        """Encode transitive relations, and chains of two relations each."""
        for name, row in self._of_type("TransitiveProperty"):
            self._add(name, "transitive", name, row)
            self._add(general(name), "transitive", general(name), row)
            self._join(name, general(name), general(name), row)
        for name, rest, row in self.pairs("propertyChainAxiom"):
            steps = self.items(rest)
            self.properties.update(steps)
            for number in range(2, len(steps)):
                joined = f"{FRESH}{number} {rest}"
                self._chain([steps[0], steps[1]], joined, row)
                self.properties.add(joined)
                steps[:2] = [joined]
            if len(steps) == 2:
                self._chain(steps, name, row)

    def _chain(self, steps: list[str], result: str, row: int) -> None:
        first, second = steps
        self._join(first, second, result, row)
        # x is in y, and all y are in some z
        self._join(first, general(second), general(result), row)
        self._join(general(first), general(second), general(result), row)

    def _join(self, first: str, second: str, result: str, row: int) -> None:
        self._add(first, f"{FRESH}chain {result}", second, row)
        self._add(f"{FRESH}chain {result}", "result", result, row)

    def _classes(self) -> None:
        """Encode intersections, unions and enumerations."""
        for name, rest, row in self.pairs("intersectionOf"):
            members = self.items(rest)
            for member in members:
                self._add(name, "subClassOf", member, row)
            for number, member in enumerate(members[1:], 2):
                joined = f"{FRESH}{number} {rest}"
                if number == len(members):
                    joined = name
                self._add(joined, "left", members[0], row)
                self._add(joined, "right", member, row)
                members[0] = joined
        for word in ("unionOf", "disjointUnionOf"):
            for name, rest, row in self.pairs(word):
                for member in self.items(rest):
                    self._add(member, "subClassOf", name, row)
        for name, rest, row in self.pairs("oneOf"):
            for member in self.items(rest):
                self._add(member, "type", name, row)

    def _restrictions(self) -> None:
        """Encode what each restriction says of its members."""
        for name, relation, row in self.pairs("onProperty"):
            said = False
            for value, value_row in self._enough(name):
                self._add(value, makes(relation), name, row, value_row)
                if value == WORDS["Thing"]:
                    self._add(relation, "domain", name, row, value_row)
            for value, value_row in self._fillers(name):
                if relation.startswith("_:"):
                    continue
                for part in self._parts(value) or [value]:
                    said |= not part.startswith("_:")
                    self._add(name, general(relation), part, row, value_row)
            for value, value_row in self._no_fillers(name):
                said = True
                if not value.startswith("_:"):
                    self._add(name, denied(relation), value, row, value_row)
            for word in (*_POSITIVE, *_NONE, *_COUNTS):
                if not said and name in self.of(word):
                    self.unused[word] += 1
                    break

    def _fillers(self, name: str) -> list[tuple[str, int]]:
        """Return the classes and individuals of which a restriction demands one or more."""
        fillers = list[tuple[str, int]]()
        for word in _POSITIVE:
            fillers += self.of(word).get(name, [])
        for word in _COUNTS:
            for bound, _ in self.of(word).get(name, []):
                if _number(bound) > 0:
                    fillers += self.of("onClass").get(name, [])
        return fillers

    def _enough(self, name: str) -> list[tuple[str, int]]:
        """Return the classes and individuals of which one is enough for a restriction."""
        fillers = list[tuple[str, int]]()
        for word in _POSITIVE:
            fillers += self.of(word).get(name, [])
        for bound, _ in self.of("minQualifiedCardinality").get(name, []):
            if _number(bound) == 1:
                fillers += self.of("onClass").get(name, [])
        return fillers

    def _no_fillers(self, name: str) -> list[tuple[str, int]]:
        """Return the classes of which a restriction allows none."""
        fillers = list[tuple[str, int]]()
        for word in _NONE:
            for bound, _ in self.of(word).get(name, []):
                if _number(bound) == 0:
                    fillers += self.of("onClass").get(name, [])
        return fillers

    def _parts(self, name: str) -> list[str]:
        """Return the named classes of an intersection, or the class itself if it has a name."""
        names = list[str]()
        waiting = [name]
        seen = set[str]()
        while waiting:
            member = waiting.pop()
            if member in seen:
                continue
            seen.add(member)
            intersections = self.of("intersectionOf").get(member)
            if not member.startswith("_:"):
                names.append(member)
            elif intersections:
                waiting += self.items(intersections[0][0])
        return names

    def _exclusions(self) -> None:
        """Encode which classes and relations exclude each other."""
        for word in ("disjointWith", "complementOf"):
            for name, other, row in self.pairs(word):
                self._exclude(name, other, row)
        for _, rest, row in self.pairs("disjointUnionOf"):
            self._exclude_all(rest, row, "disjointUnionOf")
        for name, row in self._of_type("AllDisjointClasses"):
            for rest, _ in self.of("members").get(name, []):
                self._exclude_all(rest, row, "AllDisjointClasses")
        for name, row in self._of_type("AllDisjointProperties"):
            for rest, _ in self.of("members").get(name, []):
                members = self.items(rest)[:_MOST_MEMBERS]
                self.properties.update(members)
                for first, second in permutations(members, 2):
                    self._add(first, "propertyDisjointWith", second, row)

    def _relations(self) -> None:
        """Encode which relation states in general what one states, and which deny it."""
        denying = self._denies()
        for name in sorted(self.properties):
            if name.startswith("_:"):
                continue
            self._add(name, "general", general(name))
            self._add(general(name), "neededBy", makes(name))
            if denying:
                self._add(name, "denied", denial(name))
                self._add(name, "generallyDenied", denied(name))

    def _denies(self) -> bool:
        """Return whether anything is denied but membership in classes."""
        if self.of("assertionProperty") or self.of("propertyDisjointWith"):
            return True
        for _, relation, _, _ in self.encoded:
            is_denied = relation.startswith(denied(""))
            if is_denied or relation == WORDS["propertyDisjointWith"]:
                return True
        return False

    def _exclude_all(self, rest: str, row: int, word: str) -> None:
        members = self.items(rest)
        if len(members) > _MOST_MEMBERS:
            self.unused[f"{word} of {len(members)}"] += 1
            return
        for first, second in permutations(members, 2):
            self._exclude(first, second, row)

    def _exclude(self, name: str, other: str, row: int) -> None:
        """Encode that no member of a class is one of another class or restriction."""
        self._add(name, "excludes", other, row)
        self._add(other, "excludes", name, row)
        for one, restriction in ((name, other), (other, name)):
            for relation, relation_row in self.of("onProperty").get(restriction, []):
                for value, value_row in self._enough(restriction):
                    if not value.startswith("_:"):
                        rows = (row, relation_row, value_row)
                        self._add(one, denied(relation), value, *rows)


def _number(name: str) -> float:
    """Return the number of a literal, -1 of others."""
    literal = parse_literal(name)
    if literal is None or not literal.value.isdecimal():
        return -1
    return int(literal.value)
