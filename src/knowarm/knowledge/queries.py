"""Queries: what a graph can be asked about objects, and which objects with colours answer.

A condition is a relation and a value ("usedFor drinking"); a query is one condition or several
("usedFor drinking and hasColor blue"). It never names an object.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Literal, get_args

import numpy as np

from knowarm.errors import UserError, unknown_name
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.terms import local_name, parse_literal

AND = " and "
"""What joins the conditions of a query in its text."""

COLOUR_RELATION = "hasColor"
"""The relation whose values are colours: the facet answers it, not the graph."""

Pairs = Literal["none", "colour", "all"]
"""Queries of two conditions: none, one about the object and one about its colour, or any two."""


@dataclass(frozen=True, order=True)
class Condition:
    """A relation and a value, by the last parts of their names."""

    relation: str
    value: str

    @property
    def name(self) -> str:
        """The condition in words: "usedFor drinking"."""
        return f"{self.relation} {self.value}"

    @property
    def is_colour(self) -> bool:
        """Whether the colour of a facet answers it."""
        return self.relation == COLOUR_RELATION


@dataclass(frozen=True, order=True)
class Query:
    """Conditions that an object must satisfy, all of them."""

    conditions: tuple[Condition, ...]

    @property
    def name(self) -> str:
        """The query in words: "usedFor drinking and hasColor blue"."""
        return AND.join(condition.name for condition in self.conditions)

    @classmethod
    def parse(cls, text: str, relations: Iterable[str] = ()) -> "Query":
        """Read a query from its text, e.g. "usedFor drinking and hasColor blue".

        Args:
            text: conditions joined by "and".
            relations: short names of relations; any other relation is one word.

        Raises:
            UserError: a condition has no value.
        """
        known = sorted({*relations, COLOUR_RELATION}, key=len, reverse=True)
        parts: list[str] = []
        for part in text.split(AND):
            if parts and " " not in part.strip():  # a value that holds the word "and"
                parts[-1] += AND + part
            else:
                parts.append(part)
        conditions = []
        for part in map(str.strip, parts):
            starts = (name for name in known if part.startswith(f"{name} "))
            relation = next(starts, part.split(" ")[0])
            value = part.removeprefix(relation).strip()
            if not value:
                raise UserError(
                    f"The query {text!r} needs a relation and a value, e.g. 'usedFor drinking', "
                    f"or two of these joined by 'and'; got {part!r}."
                )
            conditions.append(Condition(relation, value))
        return cls(tuple(conditions))


class QueryGraph:
    """A graph with the facets of a task: what can be asked, and the answers.

    Args:
        graph: facts about the objects, in which a relation and a value are a condition.
        facets: (object, colour) pairs of the task.

    Attributes:
        graph: as given.
        facets: as given, as a tuple.
        objects: names of the objects, in order of first appearance.

    Raises:
        UserError: the graph lacks an object, or there are no facets.
    """

    def __init__(self, graph: KnowledgeGraph, facets: Iterable[tuple[str, str]]) -> None:
        self.graph, self.facets = graph, tuple((name, colour) for name, colour in facets)
        self.objects = tuple(dict.fromkeys(name for name, _ in self.facets))
        if not self.facets:
            raise UserError("There are no facets to ask about: give at least one object.")
        self._ids = np.array([self._object(name) for name in self.objects])
        self._owner = np.array([self.objects.index(name) for name, _ in self.facets])

    @cached_property
    def conditions(self) -> tuple[Condition, ...]:
        """Every condition that a facet satisfies, sorted; colours come last.

        A value that is one of the objects is no condition, since a query
        never names an object.
        """
        graph, found = self.graph, set[Condition]()
        for entity in self._ids:
            rows = graph.out_rows(entity)
            pairs = zip(graph.relations[rows], graph.tails[rows], strict=True)
            found |= {
                Condition(local_name(graph.relation_names[r]), local_name(graph.names[t]))
                for r, t in pairs
                if t not in self._ids and parse_literal(graph.names[t]) is None
            }
        facts = sorted(each for each in found if not each.is_colour)
        colours = sorted({colour for _, colour in self.facets})
        every = [*facts, *(Condition(COLOUR_RELATION, colour) for colour in colours)]
        answers = self.answers([Query((condition,)) for condition in every])
        keep = np.asarray(answers.any(1))
        return tuple(condition for condition, kept in zip(every, keep, strict=True) if kept)

    def queries(self, pairs: Pairs = "colour") -> tuple[Query, ...]:
        """Return the queries that some facets answer and others do not.

        First those of one condition, then those of two of which neither condition is superfluous.

        Args:
            pairs: which queries of two conditions.

        Raises:
            UserError: an unknown value of ``pairs``, or nothing that tells the objects apart.
        """
        if pairs not in get_args(Pairs):
            raise unknown_name("value of pairs", pairs, get_args(Pairs))
        conditions = self.conditions
        answers = self.answers([Query((condition,)) for condition in conditions])
        useful = np.asarray(answers.any(1) & ~answers.all(1))
        conditions = tuple(c for c, kept in zip(conditions, useful, strict=True) if kept)
        if not conditions:
            raise UserError(
                f"The graph has no fact that tells {', '.join(self.objects[:8])} apart, so there "
                "is nothing to ask. Add facts that some of the objects share and others do not."
            )
        single = [Query((condition,)) for condition in conditions]
        if pairs == "none":
            return tuple(single)
        double = [
            Query(pair)
            for pair in combinations(conditions, 2)
            if pair[1].is_colour != pair[0].is_colour or (pairs == "all" and not pair[0].is_colour)
        ]
        by_query = dict(zip(single, answers[useful], strict=True))
        kept = []
        for query in double:
            first, second = (by_query[Query((condition,))] for condition in query.conditions)
            both = first & second
            if both.any() and (both != first).any() and (both != second).any():
                kept.append(query)
        return (*single, *kept)

    def answers(self, queries: Sequence[Query]) -> np.ndarray:
        """Return whether each facet answers each query, (Q, F) bool.

        A condition on the colour is answered by the facet's own colour, any other by the graph's
        triples about the facet's object.
        """
        rows = {c: self._holders(c) for query in queries for c in query.conditions}
        found = np.ones((len(queries), len(self.facets)), bool)
        for row, query in zip(found, queries, strict=True):
            for condition in query.conditions:
                row &= rows[condition]
        return found

    def parse(self, text: str) -> Query:
        """Read a query from its text, e.g. "usedFor drinking and hasColor blue".

        Raises:
            UserError: a relation or value that the graph does not have, an object's name as the
                value, or a query that no facet answers.
        """
        known = {condition.relation for condition in self.conditions} | {COLOUR_RELATION}
        query = Query.parse(text, known)
        for condition in query.conditions:
            if condition.relation not in known:
                raise unknown_name("relation of the query", condition.relation, known)
            if condition.value in self.objects:
                raise UserError(
                    f"The query {text!r} names the object {condition.value!r}. A query asks for "
                    "what the graph knows about an object, such as its use, never for its name."
                )
            values = {c.value for c in self.conditions if c.relation == condition.relation}
            if condition.value not in values:
                kind = f"value of {condition.relation} in a query"
                raise unknown_name(kind, condition.value, values)
        if not self.answers([query]).any():
            alone = [
                f"{c.name!r}: {', '.join(self._names(c)) or 'nothing'}" for c in query.conditions
            ]
            raise UserError(
                f"Nothing answers the query {text!r}. Its conditions are answered by "
                f"{'; '.join(alone)}. Ask another query, or add the missing triple to the graph."
            )
        return query

    def possible(self) -> np.ndarray:
        """Return whether the graph lets each object have its facet's colour, (F,) bool.

        An object of which the graph states colours has these only, any other has all.

        Raises:
            UserError: an object has none of the colours that the graph states.
        """
        graph = self.graph
        wanted = {
            i for i, name in enumerate(graph.relation_names) if local_name(name) == COLOUR_RELATION
        }
        stated = {}
        for name, entity in zip(self.objects, self._ids, strict=True):
            rows = graph.out_rows(entity)
            tails = graph.tails[rows][np.isin(graph.relations[rows], list(wanted))]
            stated[name] = {local_name(graph.names[i]) for i in tails}
        found = np.array([not stated[n] or colour in stated[n] for n, colour in self.facets])
        for name in self.objects:
            own = [colour for each, colour in self.facets if each == name]
            if not found[[each == name for each, _ in self.facets]].any():
                raise UserError(
                    f"The graph gives {name!r} the colours {', '.join(sorted(stated[name]))}, but "
                    f"the task can show it in {', '.join(own)} only. State one of these, or none."
                )
        return found

    # ------------------------------------------------------------------ parts

    def _object(self, name: str) -> int:
        try:
            return self.graph.entity_id(name)
        except UserError as error:
            raise UserError(
                f"The graph says nothing about the object {name!r}. {error} Add triples about "
                "it, or leave the object out of the task."
            ) from error

    def _holders(self, condition: Condition) -> np.ndarray:
        """Return which facets satisfy a condition, (F,) bool."""
        if condition.is_colour:
            return np.array([colour == condition.value for _, colour in self.facets])
        graph = self.graph
        try:
            relation = graph.relation_id(condition.relation)
            value = graph.entity_id(condition.value)
        except UserError:  # an edited graph may lack what another one knows
            return np.zeros(len(self.facets), bool)
        rows = (graph.relations == relation) & (graph.tails == value)
        return np.asarray(np.isin(self._ids, graph.heads[rows])[self._owner])

    def _names(self, condition: Condition) -> list[str]:
        rows = np.flatnonzero(self._holders(condition))
        return list(dict.fromkeys(self.facets[row][0] for row in rows))
