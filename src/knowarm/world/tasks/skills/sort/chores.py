"""Chores of sorting: bring an object to each of the trays where one belongs."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.linalg import norm

from knowarm.arrays import Floats, Images, Integers, Mask
from knowarm.knowledge import KnowledgeGraph
from knowarm.world.tasks.asked.asked import Asking
from knowarm.world.tasks.skills.chores import Chores, Tidied, only
from knowarm.world.tasks.skills.lift.lift import State
from knowarm.world.tasks.skills.lift.model import LiftScene
from knowarm.world.tasks.skills.place.guide import ReturningGuide
from knowarm.world.tasks.skills.sort.belongings import belongings, true_belongings
from knowarm.world.tasks.skills.sort.looking import trays_by_colour

if TYPE_CHECKING:
    from knowarm.world.tasks.skills.sort.sort import Sort

APART_M = 0.025
MOVED_M = 0.03  # Way after which an object that should stay counts as moved


class SortChores(Chores):
    """n scenes with trays that stand for places; see `Chores`.

    Args:
        skill: sorting.
        state: the scenes as they start; what the methods say is of their state then.
        asked: what is asked, by whose graph the trays of places were drawn.
    """

    def __init__(self, skill: "Sort", state: State, asked: Asking) -> None:
        scene = state.scene
        assert isinstance(scene, LiftScene)
        self._skill = skill
        self._state = state
        self._asked = asked
        self._start = state.positions
        self._centres = skill.tray_centres(scene.robot)
        facts = skill.facts(state, asked)
        self.relation = skill.relation
        self.told = {"places": facts["tray_places"], "marks": facts["tray_colours"]}
        self.spots = apart(self._centres)
        limit = float(state.limits[1])
        largest_step = float(state.increments.max())
        self.guide = ReturningGuide(scene, largest_step, limit, state.ignore_roll)

    def seen(self, images: Images) -> Integers:
        """See `Chores.seen`."""
        scene = self._state.scene
        return trays_by_colour(scene, images, self._centres, self.told["marks"])

    def belongs(self, graph: KnowledgeGraph | None, objects: Integers) -> Mask:
        """See `Chores.belongs`."""
        facets = tuple((target.name, "") for target in self._state.scene.targets)
        known = belongings(graph, facets, self.relation)
        return known.of(objects, self.told["places"])

    def fits(self) -> Mask:
        """See `Chores.fits`."""
        known = true_belongings(self._asked, self._state.facets, self.relation)
        belongs = known.of(self._state.objects, self.told["places"])
        is_one_each = (belongs.sum(axis=1) == 1).all(axis=1)
        return is_one_each & (belongs.sum(axis=2) <= 1).all(axis=1)

    def judge(self, graph: KnowledgeGraph) -> Tidied:
        """See `Chores.judge`."""
        state = self._state
        count = len(self._centres)
        # What is told is in the order of the places.
        numbers = np.argsort(state.memory["tray_places"][:, :count], axis=1)
        stands = []
        moved = []
        starts = self._start.transpose(1, 0, 2)
        for objects, places in zip(state.objects.T, starts, strict=True):
            stands.append(self._skill.trays(state, objects))
            moved.append(state.simulator.displacement(objects, places) > MOVED_M)
        return Tidied(
            belongs=only(self.belongs(graph, state.objects), numbers),
            stands=np.stack(stands, axis=1),
            moved=np.stack(moved, axis=1),
        )

    def instruct(self, scene: int) -> str:
        """See `Chores.instruct`."""
        return self._skill.instruct(self._state, self._asked, scene)


def apart(centres: Floats) -> Floats:
    """Return where objects are put on trays (K, 2): `APART_M` from their middle.

    Away from the nearest other tray, so that the gripper does not touch what stands there.
    """
    offset = centres[:, None] - centres
    distance = norm(offset, axis=2)
    np.fill_diagonal(distance, np.inf)
    rows = np.arange(len(centres))
    nearest = distance.argmin(axis=1)
    away = offset[rows, nearest] / distance[rows, nearest, None]
    return centres + APART_M * away
