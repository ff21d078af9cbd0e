"""Episodes with a question: which objects stand where, and which question singles out one."""

from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from knowarm.arrays import Floats, Integers
from knowarm.errors import UserError
from knowarm.questions import QuestionTable, number_parts, with_distractors
from knowarm.world.scene.scene import Scene
from knowarm.world.tasks.asked.query.layouts import LayoutSource, draws
from knowarm.world.tasks.asked.query.object_sets import ObjectSets, draw_object_sets
from knowarm.world.tasks.asked.query.query_source import QuerySource
from knowarm.world.tasks.sampling import DrawnObjects, Facets, Setting, derive, uniforms

# Layouts drawn for each set before it counts as too large for the rectangle

_ROUNDS = 6
MIN_FITTING = 0.05  # Least share of the sets of objects that must fit the rectangle


class Arrangements(NamedTuple):
    """Object sets that fit the rectangle, largest object first."""

    table: QuestionTable  # The questions
    sets: ObjectSets  # C sets of objects
    # A layout of each, for episodes in whose draws no layout fits, (C, m, 2) [m]
    spare: Floats


class SeveralObjects:
    """Draws objects, places and questions, which have to fit each other."""

    def __init__(self, setting: Setting, queries: QuerySource, objects: int) -> None:
        arrangements = arrange(
            setting.scene, setting.facets, queries, objects, queries.version()
        )
        table = arrangements.table
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
def question_table(
    queries: QuerySource, facets: Facets, objects: int, version: tuple[int, ...]
) -> QuestionTable:
    """Return the questions of a source about facets, of which an episode shows ``objects``.

    Facets that are parts are shown with all parts of their objects; a query is asked for a part
    only if no other part of its object satisfies it. Cached per process and ``version`` of the
    source.
    """
    count = objects // number_parts(facets).shape[1]
    table = queries.table(facets, objects)
    parts = table.parts
    if parts.shape[1] == 1:
        return table
    shown = np.any(table.shown[parts], axis=1)
    related = np.any(table.related[:, parts], axis=2)
    related = np.any(related[parts], axis=1)
    satisfied = table.satisfies[:, parts]
    askable = table.askable & (satisfied.sum(axis=2) == 1)
    by_object = np.any(satisfied, axis=2)
    askable = with_distractors(askable, by_object, related, shown, table.objects, count)
    return replace(table, askable=askable, related=related, shown=shown)


@lru_cache(maxsize=16)
def arrange(
    scene: Scene,
    facets: Facets,
    queries: QuerySource,
    m: int,
    version: tuple[int, ...],
) -> Arrangements:
    """Draw sets of m facets and find a layout of each, cached as `question_table`."""
    table = question_table(queries, facets, m, version)
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
    for round_number in range(_ROUNDS):
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
    return Arrangements(table, sets.select(is_kept), spare[number[is_kept]])
