"""Episodes with a question: which objects stand where, and which question singles out one."""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from knowarm.arrays import Floats, Integers, Mask
from knowarm.errors import UserError
from knowarm.questions import QuestionTable
from knowarm.world.scene.scene import Scene
from knowarm.world.tasks.asked.query.layouts import LayoutSource, draws
from knowarm.world.tasks.sampling import DrawnObjects, Setting, derive, uniforms

SETS = 2048
"""Sets of objects that are drawn for a task; episodes repeat them in new layouts."""

MIN_BALANCED = 256
"""Least number of balanced sets. A split that has fewer draws the question first."""

_SET_ROUNDS = 12
"""Most times that sets are drawn before a split counts as having too few."""

_LAYOUT_ROUNDS = 6
"""Layouts drawn for each set before it counts as too large for the rectangle."""

MIN_FITTING = 0.05
"""Least share of the sets of objects that must fit the rectangle."""


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


class Arrangements(NamedTuple):
    """Object sets that fit the rectangle, largest object first."""

    sets: ObjectSets  # C sets of objects
    # A layout of each, for episodes in whose draws no layout fits, (C, m, 2) [m]
    spare: Floats


class SeveralObjects:
    """Draws objects, places and questions, which have to fit each other."""

    def __init__(self, setting: Setting, table: QuestionTable, objects: int) -> None:
        arrangements = arrange(setting.scene, table, objects)
        parts = table.parts.shape[1]
        self.draws = draws(objects // parts)
        self._layouts = LayoutSource(setting.scene, parts)
        self._sets = arrangements.sets
        self._spare = arrangements.spare
        facet_target, facet_colour = facet_indices(setting.scene, table)
        self._target = facet_target[self._sets.facets]
        self._colour = facet_colour[self._sets.facets]
        self._queries = np.array([query.name for query in table.queries])
        self._rotation = np.arange(objects)

    def __call__(self, first: Floats, more: Floats) -> DrawnObjects:
        """Draw the objects of n episodes; the first draw selects the set, ``more`` the layout."""
        row = (first[:, 0] * len(self._sets)).astype(np.int64)
        position, fits = self._layouts(more, self._target[row])
        position = np.where(fits[:, None, None], position, self._spare[row])
        # The object that answers the question comes first.
        order = (self._sets.goal[row][:, None] + self._rotation) % len(self._rotation)
        return DrawnObjects(
            objects=np.take_along_axis(self._target[row], order, axis=1),
            colours=np.take_along_axis(self._colour[row], order, axis=1),
            positions=np.take_along_axis(position, order[..., None], axis=1),
            question=self._queries[self._sets.query[row]],
        )


def facet_indices(scene: Scene, table: QuestionTable) -> tuple[Integers, Integers]:
    """Return the target and colour index of each facet, (F,) each; 0 where it is not shown."""
    names = [target.name for target in scene.targets]
    target = np.zeros(len(table.facets), np.int64)
    colour = np.zeros_like(target)
    for f in np.flatnonzero(table.shown):
        name, shade = table.facets[f]
        if name not in names:
            raise UserError(
                f"The queries show {name!r}, which is not among EnvConfig.targets "
                f"({', '.join(names)}). Add it there, or leave it out of the queries' facets."
            )
        target[f] = names.index(name)
        colours = scene.colour_names[target[f]]
        if shade not in colours:
            raise UserError(
                f"The queries show a {shade} {name}; its colours are {', '.join(colours)}. Take "
                "one of these, or give the target that colour."
            )
        colour[f] = colours.index(shade)
    return target, colour


@lru_cache(maxsize=16)
def arrange(scene: Scene, table: QuestionTable, m: int) -> Arrangements:
    """Draw sets of m facets and find a layout of each; cached per process and table."""
    target, _ = facet_indices(scene, table)
    parts = table.parts.shape[1]
    layouts = LayoutSource(scene, parts)
    sets = draw_object_sets(table, m // parts)
    # The largest object is placed first, where there is most room.
    order = np.argsort(-layouts.width[target[sets.facets]], axis=1, kind="stable")
    sets = replace(
        sets,
        facets=np.take_along_axis(sets.facets, order, axis=1),
        goal=(order == sets.goal[:, None]).argmax(axis=1),
    )
    different, number = np.unique(target[sets.facets], axis=0, return_inverse=True)
    number = number.reshape(-1)
    spare = np.zeros((len(different), m, 2))
    fits = np.zeros(len(different), bool)
    for round_number in range(_LAYOUT_ROUNDS):
        left = np.flatnonzero(~fits)
        if not len(left):
            break
        stream = np.full(len(left), derive(round_number, "layouts"), np.uint64)
        u = uniforms(stream, left.astype(np.uint64), draws(m // parts))
        spare[left], fits[left] = layouts(u, different[left])
    is_kept = fits[number]
    if is_kept.mean() < MIN_FITTING:
        x, y = 2 * np.array(scene.robot.rectangle_half_size_m)
        raise UserError(
            f"{m} objects do not fit the rectangle of robot {scene.robot.name!r} ({x:.2f} x "
            f"{y:.2f} m): only {100 * is_kept.mean():.0f} % of the sets of objects can stand in it "
            "without overlapping or hiding each other. Show fewer objects (task.asked.objects), "
            "smaller ones (targets), or enlarge areas.choose of the robot."
        )
    return Arrangements(sets.select(is_kept), spare[number[is_kept]])


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
    for _ in range(_SET_ROUNDS):
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
    possible = _own_queries(table, sets).reshape(n * m, -1)
    weights = 1.0 / np.maximum(1, possible.sum(axis=0))
    query = _pick(possible, weights, generator)
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
