"""Choice source: which objects an episode shows, where they stand, and what it asks."""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knowarm.errors import UserError
from knowarm.world.arrays import Array, Place, array_namespace, here
from knowarm.world.choice import ChoiceTable, Facet
from knowarm.world.choice_config import ChoiceConfig
from knowarm.world.compositions import Compositions, draw_compositions
from knowarm.world.config import EnvConfig
from knowarm.world.draws import derive, uniforms
from knowarm.world.layouts import LayoutSource, draws
from knowarm.world.scene import Scene, list_facets, load_scene, scene_of

_ROUNDS = 6
"""Layouts drawn for each set of objects before it counts as too large for the rectangle."""

MIN_FITTING = 0.05
"""Least share of the sets of objects that must fit the rectangle."""


class Chosen(NamedTuple):
    """Objects of n episodes: the fields of ``Episodes`` that concern them."""

    target: Array
    position: Array
    colour: Array
    others: Array
    other_colour: Array
    other_position: Array
    query: Array


@dataclass(frozen=True, eq=False)
class Arrangements:
    """Compositions whose objects fit the rectangle, largest object first."""

    table: ChoiceTable
    """The table of the queries."""

    compositions: Compositions
    """C compositions."""

    spare: NDArray[np.float64]
    """A layout of each, for episodes in whose draws no layout fits, (C, m, 2) [m]."""


class ChoiceSource:
    """Draws objects, places and queries; for NumPy or torch.

    Args:
        scene: the targets and the rectangle.
        config: the task, with ``choice``.
        place: moves the constants to the device of the draws.

    Attributes:
        draws: number of draws per episode besides the first.

    Raises:
        UserError: the table of the queries does not fit the targets, or the objects do not fit the
            rectangle.
    """

    def __init__(self, scene: Scene, config: EnvConfig, place: Place = here) -> None:
        assert config.choice is not None
        self._objects = m = config.choice.objects
        self.draws = draws(m)
        self._layouts = LayoutSource(scene, place)
        found = arrange(config)
        chosen = found.compositions
        facet_target, facet_colour = facet_indices(scene, found.table)
        self._count = len(chosen)
        self._query, self._wanted = place(chosen.query), place(chosen.wanted)
        self._target, self._colour = (
            place(facet_target[chosen.facets]), place(facet_colour[chosen.facets])
        )  # fmt: skip
        self._spare = place(found.spare)
        self._rotation = place(np.arange(m))

    def __call__(self, which: Array, more: Array) -> Chosen:
        """Draw the objects of n episodes.

        Args:
            which: draw of the composition, (n,) in [0, 1).
            more: further draws, (n, ``draws``) in [0, 1).
        """
        xp = array_namespace(which)
        row = xp.astype(which * self._count, xp.int64)
        target, colour = self._target[row], self._colour[row]
        position, fits = self._layouts(more, target)
        position = xp.where(fits[:, None, None], position, self._spare[row])
        # The wanted object first.
        order = (self._wanted[row][:, None] + self._rotation) % self._objects
        episode = xp.arange(order.shape[0], device=order.device)[:, None]
        target, colour, position = (
            target[episode, order], colour[episode, order], position[episode, order]
        )  # fmt: skip
        return Chosen(
            target=target[:, 0],
            position=position[:, 0],
            colour=colour[:, 0],
            others=target[:, 1:],
            other_colour=colour[:, 1:],
            other_position=position[:, 1:],
            query=self._query[row],
        )


def choice_table(config: EnvConfig) -> ChoiceTable:
    """Return the table of the queries of a config with ``choice``; it is cached."""
    return arrange(config).table


def facet_indices(scene: Scene, table: ChoiceTable) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the target and colour index of each facet, (F,) each; 0 where it is not shown.

    Raises:
        UserError: a facet that is shown is none of the scene's.
    """
    names = [target.name for target in scene.targets]
    target, colour = np.zeros((2, len(table.facets)), dtype=np.int64)
    for f in np.flatnonzero(table.shown):
        name, shade = table.facets[f]
        if name not in names:
            raise UserError(
                f"The queries show {name!r}, which is not among EnvConfig.targets "
                f"({', '.join(names)}). Add it there, or leave it out of the queries' facets."
            )
        colours = scene.colour_names[names.index(name)]
        if shade not in colours:
            raise UserError(
                f"The queries show a {shade} {name}; its colours are {', '.join(colours)}. Take "
                "one of these, or give the target that colour."
            )
        target[f], colour[f] = names.index(name), colours.index(shade)
    return target, colour


def arrange(config: EnvConfig) -> Arrangements:
    """Draw the compositions of a config and find a layout of each, cached per process.

    Raises:
        UserError: few sets of objects fit the rectangle, or the queries do not fit the targets.
    """
    assert config.choice is not None
    facets = list_facets(scene_of(config), config.colours)
    return _arrange(config.robot, tuple(config.targets), facets, config.choice)


@lru_cache(maxsize=16)
def _arrange(
    robot: str, targets: tuple[str, ...], facets: tuple[Facet, ...], choice: ChoiceConfig
) -> Arrangements:
    scene, m = load_scene(robot, targets, several=True), choice.objects
    table = choice.queries.table(facets, m)
    target, _ = facet_indices(scene, table)
    layouts = LayoutSource(scene)
    chosen = draw_compositions(table, m)
    # The largest object is placed first, where there is most room.
    order = np.argsort(-layouts.width[target[chosen.facets]], axis=1, kind="stable")
    chosen = Compositions(
        chosen.query,
        np.take_along_axis(chosen.facets, order, axis=1),
        np.take_along_axis(np.argsort(order, axis=1), chosen.wanted[:, None], axis=1)[:, 0],
        chosen.balanced,
    )
    sets, number = np.unique(target[chosen.facets], axis=0, return_inverse=True)
    number = number.reshape(-1)
    spare, fits = np.zeros((len(sets), m, 2)), np.zeros(len(sets), dtype=np.bool_)
    for round_number in range(_ROUNDS):
        left = np.flatnonzero(~fits)
        if not len(left):
            break
        stream = np.full(len(left), derive(round_number, "layouts"), dtype=np.uint64)
        u = uniforms(stream, left.astype(np.uint64), draws(m))
        spare[left], fits[left] = layouts(u, sets[left])
    kept = fits[number]
    if kept.mean() < MIN_FITTING:
        x, y = 2 * np.array(scene.robot.rectangle_half_size_m)
        raise UserError(
            f"{m} objects do not fit the rectangle of robot {scene.robot.name!r} ({x:.2f} x "
            f"{y:.2f} m): only {100 * kept.mean():.0f} % of the sets of objects can stand in it "
            "without overlapping or hiding each other. Show fewer objects (choice.objects), "
            "smaller ones (targets), or enlarge choice_half_size_m of the robot."
        )
    return Arrangements(table, chosen.select(kept), spare[number[kept]])
