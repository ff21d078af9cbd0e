"""Object sets: which objects stand together, and which query singles out which of them."""

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from knowarm.arrays import Floats, Integers, Mask
from knowarm.questions import QuestionTable
from knowarm.world.tasks.sampling import derive

SETS = 2048
"""Sets of objects that are drawn for a task; episodes repeat them in new layouts."""

MIN_BALANCED = 256
"""Least number of balanced sets. A split that has fewer draws the question first."""

_ROUNDS = 12


@dataclass(frozen=True, eq=False)
class ObjectSets:
    """C sets of m facets each; an episode shows one of them."""

    query: Integers  # Number of the query, (C,)
    facets: Integers  # Numbers of the facets, of m different objects, (C, m)
    goal: Integers  # Position in the set of the facet that satisfies the query, 0..m-1, (C,)
    # Whether each object of a set is the goal equally often, so that only the query identifies it
    balanced: bool

    def __len__(self) -> int:
        return len(self.query)

    def select(self, rows: Mask) -> "ObjectSets":
        """Return some of the sets."""
        return ObjectSets(
            self.query[rows], self.facets[rows], self.goal[rows], self.balanced
        )


def draw_object_sets(table: QuestionTable, objects: int) -> ObjectSets:
    """Draw sets of a table; the same table gives the same ones.

    A set holds every part of each of its objects, all of which may be the goal.
    A set of objects is balanced if each of them has a query of its own that no other one of the
    set satisfies, and any two share something. Such a set becomes m rows, one per object.
    Where a split has too few of them, because it asks only for some facets, the question is drawn
    first and the distractors after it.
    """
    table.check_objects(objects)
    generator = np.random.default_rng(derive(0, "compositions"))
    drawn: list[Integers] = []
    for _ in range(_ROUNDS):
        sets = _draw_sets(table, objects, generator)
        sets = _all_parts(table, sets)
        can_be_asked = np.any(_own_queries(table, sets), axis=2)
        drawn.append(sets[can_be_asked.all(axis=1)])
        if sum(map(len, drawn)) >= SETS:
            break
    sets = np.concatenate(drawn)[:SETS]
    if len(sets) >= MIN_BALANCED:
        return _ask_each(table, sets, generator)
    return _ask_first(table, objects, generator)


def _draw_sets(table: QuestionTable, objects: int, generator: Generator) -> Integers:
    """Draw sets of facets of different objects that are shown, askable and related, (n, m)."""
    number = table.objects
    usable = table.shown & table.askable.any(axis=0)
    together = number[:, None] != number
    together &= table.related
    together &= usable
    weights = _object_weights(table, usable)
    candidates = np.repeat(usable[None], SETS, axis=0)
    chosen = np.zeros((SETS, 0), np.int64)
    for _ in range(objects):
        facet = _pick(candidates, weights, generator)
        is_possible = candidates.any(axis=1)
        chosen = np.column_stack([chosen, facet])[is_possible]
        candidates = candidates[is_possible] & together[chosen[:, -1]]
    return chosen


def _all_parts(table: QuestionTable, sets: Integers) -> Integers:
    """Return sets (n, m) with all parts of each object, one object after the other, (n, m P)."""
    return table.parts[sets].reshape(len(sets), sets.shape[1] * table.parts.shape[1])


def _object_weights(table: QuestionTable, usable: Mask) -> Floats:
    """Return weights of the facets with which every object is equally likely, (F,)."""
    number = table.objects
    counts = np.bincount(number, weights=usable)
    return 1.0 / np.maximum(1, counts)[number]


def _pick(candidates: Mask, weights: Floats, generator: Generator) -> Integers:
    """Draw one candidate per row (n, F), with probabilities proportional to weights (F,)."""
    # The largest of log(weight) + Gumbel noise is such a draw.
    scores = generator.gumbel(size=candidates.shape)
    scores += np.log(weights)
    possible = np.where(candidates, scores, -np.inf)
    return possible.argmax(axis=1)


def _own_queries(table: QuestionTable, sets: Integers) -> Mask:
    """Return which queries may be asked for a facet and single it out in its set, (n, m, Q)."""
    satisfied = table.satisfies.T[sets]
    alone = satisfied.sum(axis=1, keepdims=True) == 1
    return table.askable.T[sets] & alone


def _ask_each(table: QuestionTable, sets: Integers, generator: Generator) -> ObjectSets:
    """Give every object of every set a query, with rare queries preferred."""
    n, m = sets.shape
    own = _own_queries(table, sets).reshape(n * m, -1)
    weights = 1.0 / np.maximum(1, own.sum(axis=0))
    query = _pick(own, weights, generator)
    facets = np.repeat(sets, m, axis=0)
    goal = np.tile(np.arange(m), n)
    return ObjectSets(query, facets, goal, balanced=True)


def _ask_first(table: QuestionTable, objects: int, generator: Generator) -> ObjectSets:
    """Draw query and target, and then distractors, with every query and object equally likely."""
    count = SETS * objects
    asked = np.flatnonzero(table.askable.any(axis=1))
    query = asked[generator.integers(len(asked), size=count)]
    number = table.objects
    weights = _object_weights(table, table.shown)
    target = _pick(table.askable[query], weights, generator)
    candidates = table.distractors(query, target)
    chosen = [target]
    for _ in range(objects - 1):
        facet = _pick(candidates, weights, generator)
        is_other = number[facet][:, None] != number
        candidates = candidates & is_other
        chosen.append(facet)
    sets = generator.permuted(np.stack(chosen, axis=1), axis=1)
    facets = _all_parts(table, sets)
    answers = np.take_along_axis(table.satisfies[query], facets, axis=1)
    alone = answers.sum(axis=1) == 1
    goal = (facets == target[:, None]).argmax(axis=1)
    drawn = ObjectSets(query, facets, goal, balanced=False)
    return drawn.select(alone)
