"""OWL class axioms as plain facts: `mug subClassOf (usedFor some Drinking)` states mug usedFor
Drinking, also of what is a subclass or an instance of mug."""

from collections import Counter, defaultdict
from collections.abc import Iterator

from knowarm.knowledge.graph.builder import with_facts
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.terms import RDF, RDF_TYPE, RDFS, local_name, parse_literal

OWL = "http://www.w3.org/2002/07/owl#"
_SUBCLASS, _EQUIVALENT = RDFS + "subClassOf", OWL + "equivalentClass"
_DEEPEST = 50
"""Most classes inside each other."""
_VALUES = (OWL + "someValuesFrom", OWL + "hasValue")
_LEAST = (OWL + "qualifiedCardinality", OWL + "minQualifiedCardinality")
"""Numbers of values of `onClass`: from 1 on, there is some."""


def with_class_axioms(graph: KnowledgeGraph) -> tuple[KnowledgeGraph, int, dict[str, int]]:
    """Add the facts that class axioms state.

    Returns:
        The graph, the number of new facts, and how many axioms of which kind state none here, such
        as "allValuesFrom".
    """
    if graph.relation_names.find(OWL + "onProperty") is None:
        return graph, 0, {}
    axioms = _Axioms(graph)
    own: dict[str, set[tuple[str, str]]] = defaultdict(set)
    parents: dict[str, set[str]] = defaultdict(set)
    for head, relation, tail in graph:
        if head.startswith("_:") or relation not in (_SUBCLASS, _EQUIVALENT, RDF_TYPE):
            continue
        for what, value in axioms.facts(tail):
            if what == _SUBCLASS:
                parents[head].add(value)
            else:
                own[head].add((what, value))
    new = set()
    for name in {*own, *parents}:
        above, found = [name], {name}
        while above:
            each = above.pop()
            new |= {(name, *fact) for fact in own.get(each, ())}
            above += parents.get(each, set()) - found
            found |= parents.get(each, set())
    whole = with_facts(graph, new)
    return whole, len(whole) - len(graph), dict(axioms.others)


class _Axioms:
    """The anonymous classes of a graph."""

    def __init__(self, graph: KnowledgeGraph) -> None:
        self.others = Counter[str]()
        self._about: dict[str, dict[str, list[str]]] = defaultdict(lambda: defaultdict(list))
        for head, relation, tail in graph:
            if head.startswith("_:"):
                self._about[head][relation].append(tail)

    def facts(self, name: str, inside: tuple[str, ...] = ()) -> Iterator[tuple[str, str]]:
        """Yield relations and values that hold of what belongs to a class, ``inside`` others."""
        about, trail = self._about.get(name), (*inside, name)
        if about is None:
            yield _SUBCLASS, name
        elif name in inside or len(inside) > _DEEPEST:
            self.others["circle"] += 1
        elif members := about.get(OWL + "intersectionOf"):
            for member in self._items(members[0]):
                yield from self.facts(member, trail)
        else:
            values = [value for key in _VALUES for value in about.get(key, ())]
            least = (parse_literal(value) for key in _LEAST for value in about.get(key, ()))
            if any(number and number.value not in ("", "0") for number in least):
                values += about.get(OWL + "onClass", ())
            of = about.get(OWL + "onProperty", ["_:"])[0]
            within = (fact for value in values for fact in self.facts(value, trail))
            named = [value for relation, value in within if relation == _SUBCLASS]
            if not named or of.startswith("_:"):
                kinds = about.keys() - {RDF_TYPE, OWL + "onProperty", OWL + "onClass"}
                self.others[local_name(min(kinds, default="Class"))] += 1
                return
            yield from ((of, value) for value in named)

    def _items(self, rest: str) -> Iterator[str]:
        """Yield the members of an RDF list."""
        seen = set[str]()
        while rest in self._about and rest not in seen:
            seen.add(rest)
            yield from self._about[rest][RDF + "first"]
            rest = next(iter(self._about[rest][RDF + "rest"]), "")
