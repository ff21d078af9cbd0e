"""Queries that a graph answers: which there are, and which objects with colours answer them."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from functools import cache, cached_property
from itertools import chain, combinations, compress
from typing import Literal, get_args

import numpy as np

from knowarm.arrays import Mask
from knowarm.errors import UserError, unknown_name
from knowarm.knowledge.graph.denials import opposed
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.homonyms import object_ids
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
    conditions = list[tuple[str, str]]()
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

    ``owner`` (F,) is the number of each facet's object among ``objects``.
    """

    def __init__(self, graph: KnowledgeGraph, facets: Iterable[ObjectColour]) -> None:
        self.graph = graph
        self.facets = tuple((name, colour) for name, colour in facets)
        self.objects = tuple(dict.fromkeys(name for name, _ in self.facets))
        if not self.facets:
            raise UserError(
                "There are no facets to ask about: give at least one object."
            )
        self._ids = np.array(object_ids(graph, self.objects))
        self.owner = number_objects(self.facets)
        names, colours = zip(*self.facets, strict=True)
        self._wholes = np.array(list(map(object_of, names)))
        self._colours = np.array(colours)
        self._holders = cache(self._find_holders)

    @cached_property
    def conditions(self) -> tuple[Condition, ...]:
        """Every condition that a facet satisfies, sorted; colours and objects come last.

        A value that is one of the objects is no condition, since a query
        never names an object.
        """
        graph = self.graph
        stated = set[Condition]()
        for entity in self._ids:
            for row in graph.out_rows(entity):
                tail = graph.tails[row]
                if tail in self._ids or graph.names[tail].startswith(('"', "_:")):
                    continue
                relation = graph.relation_names.short(graph.relations[row])
                condition = Condition(relation, graph.names.short(tail))
                if not condition._replace(relation=local_name(relation)).is_seen:
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
        rows = dict[Condition, Mask]()
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
        for name, colour in graph_facets(self.objects, self.graph, COLOUR_RELATION):
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
        values = graph.values(condition.value)
        stated = self._stated([relation], values)
        denying = opposed(graph, graph.relation_names[relation])
        # What the graph both states and denies does not count
        is_denied = self._stated(denying, values) >= SURE
        return np.where(is_denied, 0, stated)[self.owner]

    def _stated(self, relations: Sequence[int], values: Sequence[int]) -> Degrees:
        """Return the probability that relations lead from each object to a value, (n,)."""
        graph = self.graph
        has_relation = np.isin(graph.relations, relations)
        rows = np.flatnonzero(has_relation & np.isin(graph.tails, values))
        if not graph.confidence:
            return np.isin(self._ids, graph.heads[rows]).astype(float)
        # Probability that no triple about an object holds
        wrong = np.ones(len(self._ids))
        for head, share in zip(
            graph.heads[rows], graph.probabilities(rows), strict=True
        ):
            wrong[self._ids == head] *= 1 - share
        return 1 - wrong
