"""Queries that a graph answers: which there are, and which objects with colours answer them."""

from collections import defaultdict
from collections.abc import Collection, Iterable, Sequence
from functools import cache, cached_property
from itertools import chain, combinations, compress
from typing import Literal, get_args

import numpy as np

from knowarm.arrays import Mask
from knowarm.errors import UserError, unknown_name
from knowarm.knowledge.graph.denials import opposed
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.homonyms import described_id, named_objects
from knowarm.knowledge.graph.individuals import (
    Tellers,
    classes_of_value,
    may_be,
    values_of,
    with_individuals,
)
from knowarm.knowledge.graph.terms import local_name
from knowarm.knowledge.slots import graph_facets
from knowarm.questions import (
    AND,
    COLOUR_RELATION,
    OBJECT_RELATION,
    SURE,
    Condition,
    ObjectColour,
    Query,
    number_objects,
    object_of,
)

Degrees = np.ndarray
"""Probabilities that facets satisfy conditions or answer queries, 0 to 1."""
Pairs = Literal["none", "colour", "all"]
"""Queries of two conditions: none, a fact and a colour (or the object of a part), or any two."""


def parse_query(text: str) -> Query:
    """Read a query from its name, e.g. "usedFor drinking and hasColor blue"."""
    conditions = []
    for part in text.split(AND):
        relation, _, value = part.strip().partition(" ")
        if value:
            conditions.append((relation, value.strip()))
        elif conditions:  # a value with an "and"
            relation, value = conditions.pop()
            conditions.append((relation, value + AND + part.strip()))
        else:
            raise UserError(
                f"The query {text!r} needs a relation and a value, e.g. 'usedFor drinking', or two "
                f"of these joined by 'and'; got {relation!r}."
            )
    return Query.of(*conditions)


class QueryGraph:
    """A graph with the (object, colour) facets of a task: what can be asked, and the answers.

    A facet satisfies what one of the individuals that it may be does, or else what the entity of
    its name does. ``owner`` (F,) is the number of each facet's object among ``objects``.
    """

    def __init__(self, graph: KnowledgeGraph, facets: Iterable[ObjectColour]) -> None:
        self.graph = graph
        self.facets = tuple((name, colour) for name, colour in facets)
        self.objects = tuple(dict.fromkeys(name for name, _ in self.facets))
        if not self.facets:
            raise UserError(
                "There are no facets to ask about: give at least one object."
            )
        entities = named_objects(graph, self.objects)
        self._meant = with_individuals(graph, entities)
        for name in entities.keys() - self._meant.keys():
            described_id(graph, name)  # which raises the error
        self.owner = number_objects(self.facets)
        names, colours = zip(*self.facets, strict=True)
        self._wholes = np.array(list(map(object_of, names)))
        self._colours = np.array(colours)
        self._holders = cache(self._find_holders)
        self._tellers = Tellers(graph)
        # What each facet may be, one after the other, and where that of each begins
        self._seen_as = list[int | None]()
        self._starts = list[int]()
        for name, colour in self.facets:
            self._starts.append(len(self._seen_as))
            self._seen_as += may_be(graph, self._meant[name], colour)
        self._told_by = defaultdict[int, set[int]](set)
        for entity in set(self._seen_as):
            if entity is not None:
                for teller in chain.from_iterable(self._tellers.of(entity, ())):
                    self._told_by[teller].add(entity)

    @cached_property
    def conditions(self) -> tuple[Condition, ...]:
        """Every condition that a facet satisfies, sorted; colours and objects come last.

        A value that is one of the objects is no condition, since a query
        never names an object.
        """
        graph = self.graph
        individuals = set[int]()
        of_objects = set[int | None]()
        for described in self._meant.values():
            individuals.update(described.individuals)
            of_objects.add(described.entity)
        of_objects |= individuals
        stated = set()
        for teller, told in self._told_by.items():
            for index, tail in self._tellers.stated(teller):
                values = [tail]
                if not individuals.isdisjoint(told):  # "on table" of what is on table_4
                    values += classes_of_value(graph, tail)
                relation = graph.relation_names.short(index)
                for value in values:
                    condition = Condition(relation, graph.names.short(value))
                    is_unnamed = graph.names[value].startswith(('"', "_:"))
                    is_seen = condition._replace(relation=local_name(relation)).is_seen
                    if not (is_unnamed or is_seen or value in of_objects):
                        stated.add(condition)
        whole = set(map(object_of, self.objects)).difference(self.objects)
        colours = {Condition(COLOUR_RELATION, colour) for _, colour in self.facets}
        objects = {Condition(OBJECT_RELATION, name) for name in whole}
        conditions = chain(sorted(stated), sorted(colours), sorted(objects))
        return tuple(c for c in conditions if (self._holders(c) >= SURE).any())

    def queries(self, pairs: Pairs = "colour") -> tuple[Query, ...]:
        """Return the queries that some facets answer and others do not.

        First those of one condition, then those of two of which neither condition is superfluous.
        """
        if pairs not in get_args(Pairs):
            raise unknown_name("value of pairs", pairs, get_args(Pairs))
        rows = {}
        for condition in self.conditions:
            row = self._holders(condition) >= SURE
            if not row.all():
                rows[condition] = row
        if not rows:
            raise UserError(
                f"The graph has no fact that tells {', '.join(self.objects[:8])} apart, so there "
                "is nothing to ask. Add facts that some of the objects share and others do not."
            )
        queries = list(map(Query.of, rows))
        if pairs == "none":
            return tuple(queries)
        for first, second in combinations(rows, 2):
            is_mixed = first.is_seen != second.is_seen
            if not is_mixed and (pairs == "colour" or first.is_seen):
                continue
            both = rows[first] & rows[second]
            if 0 < both.sum() < min(rows[first].sum(), rows[second].sum()):
                queries.append(Query((first, second)))
        return tuple(queries)

    def answers(self, queries: Sequence[Query]) -> Mask:
        """Return whether each facet answers each query more probably than not, (Q, F) bool.

        A condition on the colour, or on the object of a part, is answered by the facet itself, any
        other by the graph's triples about the facet's object or part.
        """
        return self.degrees(queries) >= SURE

    def degrees(self, queries: Sequence[Query]) -> Degrees:
        """Return the probability that each facet answers each query, (Q, F) float32.

        It is 0 or 1, but for triples with a confidence, which are taken as independent.
        """
        table = np.ones((len(queries), len(self.facets)), np.float32)
        for row, query in zip(table, queries, strict=True):
            for condition in query.conditions:
                row *= self._holders(condition)
        return table

    def possible(self) -> Mask:
        """Return whether the graph lets each object have its facet's colour, (F,) bool.

        An object of which the graph states colours has these only, any other has all.
        """
        stated: dict[str, set[str]] = defaultdict(set)
        named = [name for name in self.objects if self._meant[name].entity is not None]
        for name, colour in graph_facets(named, self.graph, COLOUR_RELATION):
            if colour:
                stated[name].add(colour)
        allowed = [c in stated.get(name, {c}) for name, c in self.facets]
        shown = dict(compress(self.facets, allowed))
        for name in self.objects:
            if name not in shown:
                colours = ", ".join(c for other, c in self.facets if other == name)
                raise UserError(
                    f"The graph gives {name!r} the colours {', '.join(sorted(stated[name]))}, but "
                    f"the task can show it in {colours} only. State one of these, or none."
                )
        return np.array(allowed)

    def _find_holders(self, condition: Condition) -> Degrees:
        """Return the probability that each facet satisfies a condition, (F,)."""
        if condition.relation == COLOUR_RELATION:
            return self._colours == condition.value
        if condition.relation == OBJECT_RELATION:
            return self._wholes == condition.value
        graph = self.graph
        relation = graph.find_relation(condition.relation)
        if relation is None:  # an edited graph may lack what another one knows
            return np.zeros(len(self.facets), bool)
        values = values_of(graph, condition.value, graph.has_node)
        relations = [relation, *opposed(graph, graph.relation_names[relation])]
        is_told = np.isin(graph.relations, relations)
        is_told &= np.isin(graph.tails, list(values))
        shares = dict[int | None, float]()
        for teller in np.unique(graph.heads[is_told]).tolist():
            for entity in self._told_by.get(teller, ()):
                shares[entity] = self._share(entity, relations, values)
        of_entities = [shares.get(entity, 0.0) for entity in self._seen_as]
        return np.maximum.reduceat(of_entities, self._starts)

    def _share(
        self, entity: int, relations: Sequence[int], values: Collection[int]
    ) -> float:
        """Return the probability that a relation leads from an entity to one of some values.

        It is 0 if a further one, which denies the first, does so, too: what the graph both states
        and denies does not count.
        """
        stating, *denying = relations
        for tellers in self._tellers.of(entity, [stating]):
            stated = self._probability(tellers, [stating], values)
            denied = self._probability(tellers, denying, values)
            if stated or denied:
                return stated if denied < SURE else 0.0
        return 0.0

    def _probability(
        self, tellers: list[int], relations: Sequence[int], values: Collection[int]
    ) -> float:
        """Return the probability that one of what entities state of some values holds."""
        wrong = 1.0
        facts = self._tellers.facts(tellers, relations)
        for (relation, tail), head in facts.items():
            if tail in values:
                triple = self.graph.named((head, relation, tail))
                wrong *= 1 - self.graph.confidence.get(triple, 1)
        return 1 - wrong
