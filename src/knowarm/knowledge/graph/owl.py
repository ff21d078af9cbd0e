"""OWL class axioms as plain facts: `mug subClassOf (usedFor some Drinking)` states mug usedFor
Drinking, also of what is a subclass or an instance of mug."""

from collections import Counter, defaultdict
from collections.abc import Iterator

from knowarm.knowledge.graph.builder import with_facts
from knowarm.knowledge.graph.graph import KnowledgeGraph, Triple
from knowarm.knowledge.graph.terms import RDF, RDF_TYPE, RDFS, local_name, parse_literal

OWL = "http://www.w3.org/2002/07/owl#"
_SUBCLASS = RDFS + "subClassOf"
_ON_CLASS = OWL + "onClass"
_ON_PROPERTY = OWL + "onProperty"
_INTERSECTION = OWL + "intersectionOf"
_RESTRICTIONS = (
    OWL + "someValuesFrom",
    OWL + "hasValue",
    OWL + "qualifiedCardinality",
    OWL + "minQualifiedCardinality",
    _ON_CLASS,
)
_DEEPEST = 50
"""Most classes inside each other."""
_AXIOMS = (_SUBCLASS, OWL + "equivalentClass", RDF_TYPE)
_About = defaultdict[str, list[str]]
"""What is said about an anonymous class: values by relation."""


def with_class_axioms(
    graph: KnowledgeGraph,
) -> tuple[KnowledgeGraph, int, dict[str, int]]:
    """Add the facts that class axioms state.

    Returns:
        The graph, the number of new facts, and how many axioms of which kind state none here, such
        as "allValuesFrom".
    """
    if graph.relation_names.find(_ON_PROPERTY) is None:
        return graph, 0, {}
    axioms = _Axioms(graph)
    stated: dict[str, set[tuple[str, str]]] = defaultdict(set)
    for head, relation, tail in graph:
        if relation in _AXIOMS and not head.startswith("_:"):
            stated[head].update(axioms.facts(tail))
    facts = set[Triple]()
    for name in stated:
        seen = {name}
        waiting = [name]
        while waiting:
            for relation, value in stated.get(waiting.pop(), ()):
                if relation != _SUBCLASS:
                    facts.add((name, relation, value))
                elif value not in seen:
                    seen.add(value)
                    waiting.append(value)
    extended = with_facts(graph, facts)
    return extended, len(extended) - len(graph), dict(axioms.others)


class _Axioms:
    """The anonymous classes of a graph, by the names of their blank nodes."""

    def __init__(self, graph: KnowledgeGraph) -> None:
        self.others = Counter[str]()
        self._classes: dict[str, _About] = defaultdict(lambda: _About(list))
        for head, relation, tail in graph:
            if head.startswith("_:"):
                self._classes[head][relation].append(tail)

    def facts(
        self, name: str, inside: tuple[str, ...] = ()
    ) -> Iterator[tuple[str, str]]:
        """Yield relations and values that hold of what belongs to a class, ``inside`` others.

        A class with a name is a value of "subclass of".
        """
        about = self._classes.get(name)
        if about is None:
            yield _SUBCLASS, name
            return
        if name in inside or len(inside) > _DEEPEST:
            self.others["circle"] += 1
            return
        inside += (name,)
        if _INTERSECTION in about:
            for member in self._items(about[_INTERSECTION][0]):
                yield from self.facts(member, inside)
            return
        relation = about.get(_ON_PROPERTY, ["_:"])[0]
        values = list[str]()
        for filler in self._fillers(about):
            for kind, value in self.facts(filler, inside):
                if kind == _SUBCLASS:
                    values.append(value)
        if not values or relation.startswith("_:"):
            kinds = about.keys() - {RDF_TYPE, _ON_PROPERTY, _ON_CLASS}
            self.others[local_name(min(kinds, default="Class"))] += 1
            return
        for value in values:
            yield relation, value

    def _fillers(self, about: _About) -> list[str]:
        """Return the classes and individuals of which a restriction demands one or more."""
        some, value, exactly, at_least, on_class = (
            about.get(relation, []) for relation in _RESTRICTIONS
        )
        fillers = some + value
        for bound in exactly + at_least:
            number = parse_literal(bound)
            if number is not None and number.value not in ("", "0"):
                return fillers + on_class
        return fillers

    def _items(self, rest: str) -> Iterator[str]:
        """Yield the members of an RDF list."""
        seen = set[str]()
        while rest in self._classes and rest not in seen:
            seen.add(rest)
            cell = self._classes[rest]
            yield from cell[RDF + "first"]
            rest = next(iter(cell[RDF + "rest"]), "")
