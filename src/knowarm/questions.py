"""Queries and the question table: which facets answer a query, and what an episode may ask.

A condition is a relation and a value ("usedFor drinking"); a query is one condition or several
("usedFor drinking and hasColor blue"). It never names a facet. A question is a query and the
facet that is its target. A facet is an object, or one of its parts, in one of its colours.
"""

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain, combinations_with_replacement
from typing import NamedTuple

import numpy as np

from knowarm.arrays import Integers, Mask, Names
from knowarm.errors import UserError, unknown_name

AND = " and "  # What joins the conditions of a query in its name
COLOUR_RELATION = (
    "hasColor"  # Its values are colours: the facet answers it, not the graph
)
OBJECT_RELATION = "graspedOn"  # Its values are objects with parts: the facet answers it
PART = "."  # Joins the names of an object and its part: "mug.handle"
SURE = 0.5  # Probability from which a facet counts as an answer
AT_ONCE = 4096  # Questions whose distractors are found at once
TILE = 256  # Rows and columns of a matrix that are compared at once
OBJECTS_AT_ONCE = 32  # Objects among which they are looked for first
INSTANCE = "-"  # Joins the name of a kind and the number of an instance: "mug-17"
# A facet: an object or part, and one of its colours, by name
ObjectColour = tuple[str, str]


class Condition(NamedTuple):
    """A relation and a value, by the last parts of their names."""

    relation: str
    value: str

    @property
    def name(self) -> str:
        """The condition in words: "usedFor drinking"."""
        return f"{self.relation} {self.value}"

    @property
    def is_seen(self) -> bool:
        """Whether a facet answers it by its colour or object, without a graph."""
        return self.relation in (COLOUR_RELATION, OBJECT_RELATION)


@dataclass(frozen=True, order=True)
class Query:
    """Conditions that an object must satisfy, all of them."""

    conditions: tuple[Condition, ...]  #: At least one.

    @classmethod
    def of(cls, *conditions: tuple[str, str]) -> "Query":
        """Make a query of (relation, value) pairs.

        Example:
            >>> print(Query.of(("usedFor", "drinking"), ("hasColor", "blue")))
            usedFor drinking and hasColor blue
        """
        return cls(tuple(Condition(*pair) for pair in conditions))

    @property
    def name(self) -> str:
        """The query in words: "usedFor drinking and hasColor blue"."""
        return AND.join(condition.name for condition in self.conditions)

    def __str__(self) -> str:
        return self.name


def conditions_of(queries: Iterable[Query]) -> dict[Condition, None]:
    """Return the different conditions of queries as keys, in the order of the queries."""
    return dict.fromkeys(chain.from_iterable(query.conditions for query in queries))


@dataclass(frozen=True, eq=False)
class QuestionTable:
    """Questions of a task: queries, facets that answer them, and facets that stand beside these.

    Several tables share their queries and facets, and so the rows of a policy's knowledge table,
    and differ in what they ask and show: those are the splits of a study.
    """

    queries: tuple[Query, ...]
    """Q queries."""
    facets: tuple[ObjectColour, ...]
    """(object, colour) pairs, F."""
    satisfies: Mask = field(repr=False)
    """Whether a facet answers a query, (Q, F)."""
    askable: Mask = field(repr=False)
    """Whether an episode may ask a query for a facet as its target, (Q, F)."""
    related: Mask = field(repr=False)
    """Whether two facets share something, (F, F), symmetric; a distractor shares something with
    the target. The diagonal is not read."""
    shown: Mask = field(repr=False)
    """Whether a facet may stand in the rectangle, (F,)."""

    def __post_init__(self) -> None:
        queries = len(self.queries)
        facets = len(self.facets)
        _check_names("queries", list(map(str, self.queries)))
        _check_names("facets", self.facets)
        shapes = {
            "satisfies": (queries, facets),
            "askable": (queries, facets),
            "related": (facets, facets),
            "shown": (facets,),
        }
        for name, shape in shapes.items():
            array = getattr(self, name)
            if array.shape != shape or array.dtype != np.bool_:
                raise UserError(
                    f"QuestionTable.{name} must be a bool array of shape {shape} for {queries} "
                    f"queries and {facets} facets, got {array.dtype} of shape {array.shape}."
                )
        for a, b in _asymmetric(self.related):
            raise UserError(
                f"QuestionTable.related must be symmetric: {_words(self.facets[a])} and "
                f"{_words(self.facets[b])} are related in one direction only."
            )
        for query in np.flatnonzero(~self.satisfies.any(axis=1)):
            raise UserError(
                f"No facet satisfies the query {self.queries[query].name!r}: add a triple that "
                "makes one satisfy it, or remove the query."
            )
        for query, target in np.argwhere(self.askable & ~(self.satisfies & self.shown)):
            why = "does not satisfy it"
            array = "satisfies"
            if self.satisfies[query, target]:
                why = "this split does not show"
                array = "shown"
            raise UserError(
                f"The query {self.queries[query].name!r} may be asked for "
                f"{_words(self.facets[target])}, which {why}; clear that entry of askable, or set "
                f"the one of {array}."
            )
        if not self.askable.any():
            raise UserError(
                f"The split is empty: none of the {len(self.queries)} queries may be asked for "
                f"any of the {int(self.shown.sum())} facets that are shown. Hold out less, or "
                "give more objects or queries."
            )

    @cached_property
    def objects(self) -> Integers:
        """Number of each facet's object, in order of first appearance, (F,)."""
        return number_objects(self.facets, whole=True)

    @cached_property
    def parts(self) -> Integers:
        """Facets of the parts of each facet's object in its colour, itself among them, (F, P).

        Raises:
            UserError: not all objects have the same number of parts.
        """
        return number_parts(self.facets)

    def distractors(self, query: Integers, target: Integers) -> Mask:
        """Return the facets that may stand beside the targets of n questions (n,), (n, F).

        They are shown, related to the target, of another object, and do not satisfy the query.
        """
        satisfies = self.satisfies[query]
        related = self.related[target]
        target_object = self.objects[target]
        return _distractors(satisfies, related, self.shown, self.objects, target_object)

    def check_objects(self, count: int) -> None:
        """Check that every question has enough distractors for ``count`` objects per episode."""
        enough = with_distractors(
            self.askable, self.satisfies, self.related, self.shown, self.objects, count
        )
        for query, target in np.argwhere(self.askable & ~enough):
            (distractors,) = self.distractors(np.array([query]), np.array([target]))
            names = sorted({self.facets[f][0] for f in np.flatnonzero(distractors)})
            raise UserError(
                f"Query {self.queries[query].name!r} with target {_words(self.facets[target])} "
                f"has distractors of {len(names)} objects ({', '.join(names) or 'none'}) that "
                "share something with the target and do not satisfy the query; "
                f"{count} objects per episode need {count - 1}. Show more facets, relate "
                "more of them, do not ask this query for this facet, or use fewer objects."
            )


def find_rows(
    kind: str, names: Sequence[str] | Names, rows: Mapping[str, int]
) -> Integers:
    """Return the rows of names (n,) in a table, (n,).

    Args:
        kind: what the names are, for the error: "query".
        names: may repeat each other.
        rows: row of each known name.

    Raises:
        UserError: a name that the table does not have.
    """
    different, inverse = np.unique(np.asarray(names, np.str_), return_inverse=True)
    numbers = []
    for name in different.tolist():
        if name not in rows:
            raise unknown_name(kind, name, rows)
        numbers.append(rows[name])
    return np.array(numbers, dtype=np.int64)[inverse]


def number_objects(
    facets: tuple[ObjectColour, ...], *, whole: bool = False
) -> Integers:
    """Return the number of each facet's object, in order of first appearance, (F,).

    Parts of one object have different numbers, or with ``whole`` the same one.
    """
    numbers: dict[str, int] = {}
    of_facets = []
    for name, _ in facets:
        if whole:
            name = object_of(name)
        of_facets.append(numbers.setdefault(name, len(numbers)))
    return np.array(of_facets, dtype=np.int64)


def object_of(name: str) -> str:
    """Return the object of a name that may be that of a part: "mug" of "mug.handle"."""
    if "/" in name:  # an IRI has no parts
        return name
    return name.partition(PART)[0]


def kind_of(name: str) -> str:
    """Return the kind of an instance, "mug" of "mug-17"; other names stay as they are."""
    kind, joint, number = name.rpartition(INSTANCE)
    return kind if joint and number.isdecimal() else name


def number_parts(facets: tuple[ObjectColour, ...]) -> Integers:
    """Return the facets of the parts of each facet's object in its colour; see ``parts``."""
    groups: dict[ObjectColour, list[int]] = defaultdict(list)
    wholes = [(object_of(name), colour) for name, colour in facets]
    for number, whole in enumerate(wholes):
        groups[whole].append(number)
    if len(set(map(len, groups.values()))) > 1:
        counts = {name: len(group) for (name, _), group in groups.items()}
        listed = ", ".join(f"{count} of {name}" for name, count in counts.items())
        raise UserError(
            f"All objects of a task need the same number of parts, got {listed}. Add or remove "
            "parts among EnvConfig.targets."
        )
    return np.array(list(map(groups.__getitem__, wholes)), np.int64)


def with_distractors(
    allowed: Mask,
    satisfies: Mask,
    related: Mask,
    shown: Mask,
    objects: Integers,
    count: int,
) -> Mask:
    """Return the allowed questions that have distractors of ``count - 1`` objects, (Q, F)."""
    order = np.argsort(objects, kind="stable")
    order = order[shown[order]]
    _, starts = np.unique(objects[order], return_index=True)
    bounds = np.append(starts, len(order))
    query, target = np.nonzero(allowed)
    counted = np.zeros(len(query), np.int64)
    lacking = np.arange(len(query))
    first = 0
    # Most questions find enough among a few objects.
    while first < len(starts) and count > 1:
        last = min(first + max(first, OBJECTS_AT_ONCE), len(starts))
        facets = order[bounds[first] : bounds[last]]
        for start in range(0, len(lacking), AT_ONCE):
            some = lacking[start : start + AT_ONCE]
            distractors = _distractors(
                satisfies[np.ix_(query[some], facets)],
                related[np.ix_(target[some], facets)],
                shown[facets],
                objects[facets],
                objects[target[some]],
            )
            begins = starts[first:last] - starts[first]
            counted[some] += np.logical_or.reduceat(distractors, begins, 1).sum(1)
        lacking = lacking[counted[lacking] < count - 1]
        first = last
    enough = allowed.copy()
    enough[query[lacking], target[lacking]] = count <= 1
    return enough


def _distractors(
    satisfies: Mask, related: Mask, shown: Mask, objects: Integers, own: Integers
) -> Mask:
    """Return the distractors of n questions from the rows (n, F) of their queries and targets.

    ``own`` are the numbers of the targets' objects, (n,).
    """
    return np.asarray(shown & ~satisfies & related & (own[:, None] != objects))


def _asymmetric(related: Mask) -> Iterator[tuple[int, int]]:
    """Yield where a matrix (F, F) differs from its transpose, by tiles that fit into the cache."""
    begins = range(0, len(related), TILE)
    for first, second in combinations_with_replacement(begins, 2):
        rows = slice(first, first + TILE)
        columns = slice(second, second + TILE)
        for a, b in np.argwhere(related[rows, columns] != related[columns, rows].T):
            yield first + a, second + b


def _check_names(kind: str, names: Sequence[str] | Sequence[ObjectColour]) -> None:
    """Check that a table has names, and none of them twice."""
    if not names:
        raise UserError(f"QuestionTable.{kind} is empty; give at least one.")
    for name, count in Counter(names).items():
        if count > 1:
            raise UserError(
                f"QuestionTable.{kind} contains {name!r} twice; list each once."
            )


def _words(facet: ObjectColour) -> str:
    return " ".join(reversed(facet))
