"""Queries that a graph answers: which there are, and which objects with colours answer them."""

from collections.abc import Iterable, Sequence
from functools import cached_property
from itertools import combinations
from typing import Literal, get_args

import numpy as np

from knowarm.errors import UserError, unknown_name
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.terms import local_name
from knowarm.knowledge.slots import graph_facets
from knowarm.questions import (
    AND,
    COLOUR_RELATION,
    OBJECT_RELATION,
    Condition,
    ObjectColour,
    Query,
    number_objects,
    object_of,
)

Pairs = Literal["none", "colour", "all"]
"""Queries of two conditions: none, a fact and a colour (or the object of a part), or any two."""


def parse_query(text: str) -> Query:
    """Read a query from its name, e.g. "usedFor drinking and hasColor blue"."""
    parts: list[str] = []
    for part in text.split(AND):
        if parts and " " not in part.strip():  # a value with an "and"
            parts[-1] += AND + part
        else:
            parts.append(part)
    pairs = [part.strip().partition(" ") for part in parts]
    for relation in (relation for relation, _, value in pairs if not value):
        raise UserError(
            f"The query {text!r} needs a relation and a value, e.g. 'usedFor drinking', or two of "
            f"these joined by 'and'; got {relation!r}."
        )
    return Query.of(*((relation, value.strip()) for relation, _, value in pairs))


class QueryGraph:
    """A graph with the (object, colour) facets of a task: what can be asked, and the answers.

    ``owner`` (F,) is the number of each facet's object among ``objects``.
    """

    def __init__(self, graph: KnowledgeGraph, facets: Iterable[ObjectColour]) -> None:
        self.graph, self.facets = graph, tuple((name, colour) for name, colour in facets)
        self.objects = tuple(dict.fromkeys(name for name, _ in self.facets))
        if not self.facets:
            raise UserError("There are no facets to ask about: give at least one object.")
        self._ids = np.array([self._object(name) for name in self.objects])
        self.owner = number_objects(self.facets)

    @cached_property
    def conditions(self) -> tuple[Condition, ...]:
        """Every condition that a facet satisfies, sorted; colours and objects come last.

        A value that is one of the objects is no condition, since a query
        never names an object.
        """
        graph, stated = self.graph, set[Condition]()
        for entity in self._ids:
            rows = graph.out_rows(entity)
            pairs = zip(graph.relations[rows], graph.tails[rows], strict=True)
            stated |= {
                Condition(graph.relation_names.short(r), graph.names.short(t))
                for r, t in pairs
                if t not in self._ids and not graph.names[t].startswith(('"', "_:"))
            }
        facts = sorted(c for c in stated if not Condition(local_name(c.relation), c.value).is_seen)
        colours = sorted({colour for _, colour in self.facets})
        every = [*facts, *(Condition(COLOUR_RELATION, colour) for colour in colours)]
        whole = sorted({object_of(name) for name in self.objects} - {*self.objects})
        every += [Condition(OBJECT_RELATION, name) for name in whole]
        answers = self.answers([Query((condition,)) for condition in every])
        return tuple(c for c, row in zip(every, answers, strict=True) if row.any())

    def queries(self, pairs: Pairs = "colour") -> tuple[Query, ...]:
        """Return the queries that some facets answer and others do not.

        First those of one condition, then those of two of which neither condition is superfluous.
        """
        if pairs not in get_args(Pairs):
            raise unknown_name("value of pairs", pairs, get_args(Pairs))
        answers = self.answers([Query((condition,)) for condition in self.conditions])
        every = zip(self.conditions, answers, strict=True)
        rows = {condition: row for condition, row in every if row.any() and not row.all()}
        if not rows:
            raise UserError(
                f"The graph has no fact that tells {', '.join(self.objects[:8])} apart, so there "
                "is nothing to ask. Add facts that some of the objects share and others do not."
            )
        double = [
            (one, other)
            for one, other in combinations(rows, 2)
            if one.is_seen != other.is_seen or (pairs == "all" and not one.is_seen)
        ]
        kept = []
        for pair in double if pairs != "none" else ():
            both = rows[pair[0]] & rows[pair[1]]
            if both.any() and all((both != rows[each]).any() for each in pair):
                kept.append(pair)
        return tuple(Query(each) for each in (*((condition,) for condition in rows), *kept))

    def answers(self, queries: Sequence[Query]) -> np.ndarray:
        """Return whether each facet answers each query, (Q, F) bool.

        A condition on the colour, or on the object of a part, is answered by the facet itself, any
        other by the graph's triples about the facet's object or part.
        """
        return self.degrees(queries) > 0

    def degrees(self, queries: Sequence[Query]) -> np.ndarray:
        """Return the probability that each facet answers each query, (Q, F) float32.

        It is 0 or 1, but for triples with a confidence, which are taken as independent.
        """
        rows = {c: self._holders(c) for query in queries for c in query.conditions}
        table = np.ones((len(queries), len(self.facets)), np.float32)
        for row, query in zip(table, queries, strict=True):
            for condition in query.conditions:
                row *= rows[condition]
        return table

    def possible(self) -> np.ndarray:
        """Return whether the graph lets each object have its facet's colour, (F,) bool.

        An object of which the graph states colours has these only, any other has all.
        """
        stated = {name: set[str]() for name in self.objects}
        for name, colour in graph_facets(self.objects, self.graph, COLOUR_RELATION):
            stated[name] |= {colour} - {""}
        allowed = np.array([not stated[n] or colour in stated[n] for n, colour in self.facets])
        for number, name in enumerate(self.objects):
            if not allowed[self.owner == number].any():
                colours = ", ".join(colour for other, colour in self.facets if other == name)
                raise UserError(
                    f"The graph gives {name!r} the colours {', '.join(sorted(stated[name]))}, but "
                    f"the task can show it in {colours} only. State one of these, or none."
                )
        return allowed

    def _object(self, name: str) -> int:
        try:
            return self.graph.entity_id(name)
        except UserError as error:
            raise UserError(
                f"The graph says nothing about the object {name!r}. {error} Add triples about "
                "it, or leave the object out of the task."
            ) from error

    def _holders(self, condition: Condition) -> np.ndarray:
        """Return the probability that each facet satisfies a condition, (F,)."""
        if condition.is_seen:
            is_object = condition.relation == OBJECT_RELATION
            seen = ((object_of(name) if is_object else colour) for name, colour in self.facets)
            return np.array([each == condition.value for each in seen])
        graph = self.graph
        relation = graph.find_relation(condition.relation)
        if relation is None:  # an edited graph may lack what another one knows
            return np.zeros(len(self.facets), bool)
        values = graph.values(condition.value)
        rows = (graph.relations == relation) & np.isin(graph.tails, values)
        held = np.isin(self._ids, graph.heads[rows]).astype(float)
        if graph.confidence:
            wrong = np.ones(len(self._ids))  # probability that no triple about an object holds
            part = graph.rows(np.flatnonzero(rows))
            for head, triple in zip(part.heads, part, strict=True):
                wrong[self._ids == head] *= 1 - graph.confidence.get(triple, 1)
            held = 1 - wrong
        return np.asarray(held[self.owner])
