"""Sorting: put the object that is meant on the tray of the place where it belongs by a graph."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.linalg import norm

from knowarm.arrays import Array, Floats, Floats32, Images, Indices, Integers, Mask
from knowarm.errors import UserError
from knowarm.knowledge import KnowledgeGraph
from knowarm.knowledge.graph.builder import graph_of
from knowarm.knowledge.graph.terms import name_key
from knowarm.measures import Measure
from knowarm.world.objects.target import COLOURS
from knowarm.world.robots.robot import Robot
from knowarm.world.scene.scene import Scene
from knowarm.world.tasks.asked.asked import Asking
from knowarm.world.tasks.skills.chores import Chores, Tidied, only
from knowarm.world.tasks.skills.guides import DESTINATION, Sight
from knowarm.world.tasks.skills.lift.lift import State, disturbed
from knowarm.world.tasks.skills.lift.model import LiftScene
from knowarm.world.tasks.skills.place.guide import ReturningGuide
from knowarm.world.tasks.skills.place.place import (
    BESIDE,
    OUTCOMES,
    PLACED,
    Place,
    stands,
)
from knowarm.world.tasks.skills.place.tray import (
    HALF_M,
    centres_m,
    tray_name,
)
from knowarm.world.tasks.skills.sort.belongings import (
    Belongings,
    belongings,
    true_belongings,
)
from knowarm.world.tasks.skills.sort.looking import trays_by_colour
from knowarm.world.tasks.state import NamedArrays

TRAY_COLOURS = ("red", "yellow", "green", "cyan", "blue", "pink")
"""Colours of trays: far apart, so that they differ in any light."""
NAMES = np.array(TRAY_COLOURS)
TRAY_RGB = np.array([COLOURS[name] for name in TRAY_COLOURS])
MAX_TRAYS = 4
WITHOUT_POLICY = "seen"  # Algorithm that trains none
IMITATION = "distil"
WRONG_TRAY = len(OUTCOMES)
ENDS_OF_DRAWS = np.cumsum([MAX_TRAYS, MAX_TRAYS, len(TRAY_COLOURS)])
APART_M = 0.025  # Of what is put on a tray from its middle
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
        known = self._skill.known(self._state.scene, graph)
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
        simulator = state.simulator
        count = len(self._centres)
        # What is given is in the order of the places.
        numbers = np.argsort(state.memory["tray_places"][:, :count], axis=1)
        stands = []
        moved = []
        starts = self._start.transpose(1, 0, 2)
        for objects, places in zip(state.objects.T, starts, strict=True):
            stands.append(self._skill.trays(state, objects))
            way = simulator.displacement(objects, places)
            moved.append((way > MOVED_M) & ~simulator.unstable)
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


@dataclass(frozen=True, kw_only=True)
class Sort(Place):
    """Put the object that is meant on the tray of the place where it belongs.

    Each of the robot's ``trays_m`` has a colour and stands for a place, both drawn; which colour is
    which place is given, and where the object belongs follows from the graph that answers the
    questions. The object belongs at exactly one of an episode's places; a ``destination`` that the
    question names is any of these.
    """

    tells_facts = True
    outcomes = (*OUTCOMES, "wrong_tray")
    column_meanings: ClassVar[dict[str, str]] = Place.column_meanings | {
        "placing": f"how the episode ended: {', '.join(OUTCOMES)} or wrong_tray",
        "on_tray": "whether the object was put down on any tray",
        "tray_right": "whether it was put down on the tray of the place where it belongs",
    }
    measures: ClassVar[tuple[Measure, ...]] = (
        *Place.measures,
        Measure("right_tray", "right trays", "tray_right", among="on_tray"),
    )
    kind: Literal["sort"] = "sort"  # type: ignore[assignment]
    """Tag of this skill in JSON."""
    relation: str = "isLocatedIn"
    """Relation of the graph whose values are the places where objects belong."""
    destination: Literal["graph", "place", "colour"] = "graph"
    """What says where the object has to be put: the "graph", where it belongs; or the question, by
    the "place" or the "colour" of a tray that is drawn, which is given."""

    def training(self, algorithm: str, asked: Asking) -> Mapping[str, Any]:
        """Imitate as placing does; refuse what trains a policy that is not told the right tray."""
        if algorithm not in (WITHOUT_POLICY, IMITATION):
            raise UserError(
                "Only a teacher tells a policy in training which tray is right, and the algorithm "
                f"{algorithm!r} has none. Take {IMITATION!r} or {WITHOUT_POLICY!r}."
            )
        return super().training(algorithm, asked)

    @property
    def is_named(self) -> bool:
        """Whether the question names where the object has to be put."""
        return self.destination != "graph"

    @property
    def draws(self) -> int:
        """Number of draws per episode: for places, order of the trays, colours, destination."""
        return int(ENDS_OF_DRAWS[-1]) + self.is_named

    @staticmethod
    def tray_centres(robot: Robot) -> Floats:
        """Return x and y of the centres of all trays, (K, 2) [m]."""
        return centres_m(robot, least=2)[:MAX_TRAYS]

    def known(self, scene: Scene, graph: KnowledgeGraph | None) -> Belongings:
        """Return where a graph says that the objects of a scene belong."""
        facets = tuple((target.name, "") for target in scene.targets)
        return belongings(graph, facets, self.relation)

    def memory(self, num_envs: int) -> NamedArrays:
        """Remember also the place and colour of each tray, by number, -1 where there is none."""
        trays = np.full((num_envs, MAX_TRAYS), -1)
        return super().memory(num_envs) | {"tray_places": trays, "tray_colours": trays}

    def begin(
        self, state: State, asked: Asking, ids: Indices, surroundings: Floats
    ) -> NamedArrays:
        """Draw which tray has which colour and stands for which place, and the destination."""
        known = true_belongings(asked, state.facets, self.relation)
        centres = self.tray_centres(state.scene.robot)
        count = len(centres)
        of_places, of_order, of_colours, of_destination = np.split(
            surroundings, ENDS_OF_DRAWS, axis=1
        )
        places = _draw_places(known, state.target[ids], of_places[:, :count])
        order = np.argsort(of_order[:, :count], axis=1)
        places = np.take_along_axis(places, order, axis=1)
        wanted = np.zeros((len(ids), 1), np.int64)  # the place where the object belongs
        if self.is_named:
            wanted = (of_destination * count).astype(np.int64)
        right = np.argmax(order == wanted, axis=1)
        colours = np.argsort(of_colours, axis=1)[:, :count]
        return {
            DESTINATION: centres[right],
            "tray_places": _padded(places),
            "tray_colours": _padded(colours),
        }

    def paint(self, state: State, ids: Indices, rgba: Floats32) -> None:
        """Paint the trays."""
        colours = state.memory["tray_colours"][ids]
        for number in range(len(self.tray_centres(state.scene.robot))):
            geom = state.scene.model.geom(tray_name(number)).id
            rgba[:, geom, :3] = TRAY_RGB[colours[:, number]]

    def facts(self, state: State, asked: Asking) -> NamedArrays:
        """Return which tray is which place: ``tray_places`` and ``tray_colours``, (n, K) names.

        They are in the order of the places' names, which says nothing of where trays stand. Where
        questions name a destination, ``destination`` is that name, (n,).
        """
        count = len(self.tray_centres(state.scene.robot))
        places = state.memory["tray_places"][:, :count]
        colours = state.memory["tray_colours"][:, :count]
        order = np.argsort(places, axis=1)
        known = true_belongings(asked, state.facets, self.relation)
        told = {
            "tray_places": known.places[np.take_along_axis(places, order, axis=1)],
            "tray_colours": NAMES[np.take_along_axis(colours, order, axis=1)],
        }
        if self.is_named:
            centres = self.tray_centres(state.scene.robot)
            is_right = (centres == state.memory[DESTINATION][:, None]).all(axis=2)
            names = {"place": known.places[places], "colour": NAMES[colours]}
            told[DESTINATION] = names[self.destination][is_right]
        return told

    def instruct(self, state: State, asked: Asking, env_id: int) -> str:
        """Return the same of one episode, as "the red tray is the kitchen"; destination first."""
        facts = self.facts(state, asked)
        words = []
        if DESTINATION in facts:
            tray = " tray" if self.destination == "colour" else ""
            words.append(f"the destination is the {facts[DESTINATION][env_id]}{tray}")
        pairs = zip(
            facts["tray_colours"][env_id], facts["tray_places"][env_id], strict=True
        )
        words += [f"the {colour} tray is the {place}" for colour, place in pairs]
        return "; ".join(words).replace("_", " ")

    def sent(
        self, state: State, asked: Asking, env_id: int, where: str
    ) -> KnowledgeGraph | None:
        """See `Skill.sent`: words name a place, or the colour of its tray."""
        facts = self.facts(state, asked)
        places = facts["tray_places"][env_id].tolist()
        names = (*facts["tray_colours"][env_id].tolist(), *places)
        for name, place in zip(names, 2 * places, strict=True):
            if name_key(name) == name_key(where):
                objects = [target.name for target in state.scene.targets]
                return graph_of([(name, self.relation, place) for name in objects])
        return None

    def without_destination(self) -> Self:
        """Let no question name one."""
        return replace(self, destination="graph")

    def result(self, state: State, asked: Asking, env_id: int) -> str:
        """Say where it is, and on which tray."""
        outcome = self._outcome(state)[env_id]
        if outcome not in (PLACED, WRONG_TRAY):
            return super().result(state, asked, env_id)
        trays, _ = self._trays_below(state, state.target)
        tray = trays[env_id]
        colour = TRAY_COLOURS[state.memory["tray_colours"][env_id, tray]]
        places = true_belongings(asked, state.facets, self.relation).places
        place = places[state.memory["tray_places"][env_id, tray]].replace("_", " ")
        return f"It stands on the {colour} tray, the {place}."

    def swapped(self, facts: Mapping[str, Array]) -> Mapping[str, Array]:
        """Let each tray be the place of another one."""
        return {"tray_places": np.roll(facts["tray_places"], 1, axis=1)}

    def see(
        self,
        scene: Scene,
        sight: Sight,
        images: Images,
        facts: Mapping[str, Array],
        graph: KnowledgeGraph | None,
    ) -> Sight:
        """Read the trays' colours; choose that of a place where the object that is seen belongs.

        Where the graph says of none of the places, or of several, that it belongs there, it is the
        first of these trays in the robot's order. A destination that is given counts instead.
        """
        places = facts["tray_places"]
        centres = self.tray_centres(scene.robot)
        if DESTINATION in facts:
            name = facts[DESTINATION][:, None]
            belongs = (places == name) | (facts["tray_colours"] == name)
        else:
            known = self.known(scene, graph)
            belongs = known.of(sight.objects[:, :1], places)[:, 0]
        trays = trays_by_colour(scene, images, centres, facts["tray_colours"])
        is_right = np.zeros_like(belongs)
        np.put_along_axis(is_right, trays, belongs, axis=1)
        destination = centres[np.argmax(is_right, axis=1)]
        is_one = np.asarray(belongs.sum(axis=1) == 1)
        return sight._replace(destination=destination, decided=is_one)

    def chores(self, state: State, asked: Asking) -> SortChores:
        """Bring an object to each tray where one belongs."""
        return SortChores(self, state, asked)

    def solved(self, state: State, asked: Asking, graph: KnowledgeGraph) -> Mask:
        """Return which objects stand on the tray of a place where they belong by a graph, (n,)."""
        known = self.known(state.scene, graph)
        names = true_belongings(asked, state.facets, self.relation).places
        places = names[state.memory["tray_places"]]  # (n, MAX_TRAYS)
        tray = self.trays(state, state.target)
        belongs = known.of(state.objects[:, :1], places)[np.arange(len(tray)), 0, tray]
        return belongs & (tray >= 0) & ~disturbed(state)

    def trays(self, state: State, objects: Integers) -> Integers:
        """Return on which tray objects (n,) stand upright, let go: its number, or -1, (n,)."""
        number, is_over = self._trays_below(state, objects)
        return np.where(stands(state.simulator, objects) & is_over, number, -1)

    def _trays_below(self, state: State, objects: Integers) -> tuple[Integers, Mask]:
        """Return the tray nearest to objects (n,), (n,), and whether they are above it, (n,)."""
        centre = state.simulator.centre(objects)[:, None, :2]
        way = np.abs(centre - self.tray_centres(state.scene.robot)).max(axis=2)
        return way.argmin(axis=1), way.min(axis=1) < HALF_M

    def columns(self, setting: Any, infos: NamedArrays) -> NamedArrays:
        """Store also whether the object was put on a tray, and on the right one."""
        placing = infos["placing"]
        is_right = placing == "placed"
        return super().columns(setting, infos) | {
            "on_tray": is_right | (placing == self.outcomes[WRONG_TRAY]),
            "tray_right": is_right,
        }

    def _outcome(self, state: State) -> Integers:
        """Return how episodes stand; what is put down on another tray is on a wrong one."""
        outcome = super()._outcome(state)
        _, is_over = self._trays_below(state, state.target)
        outcome[(outcome == BESIDE) & is_over] = WRONG_TRAY
        return outcome


def _draw_places(known: Belongings, objects: Integers, draws: Floats) -> Integers:
    """Draw K places for objects (n,), of which only the first is right, from draws (n, K).

    Raises:
        UserError: an object belongs nowhere, or nearly everywhere.
    """
    belongs = known.belongs[objects]
    chosen = []
    allowed = belongs
    for draw in draws.T:
        count = allowed.sum(axis=1)
        if not count.all():
            name = known.objects[objects[np.argmin(count)]]
            stated = known.places[known.belongs[known.objects.index(name)]]
            raise UserError(
                f"{len(draws.T)} trays need one place where the object belongs and "
                f"{len(draws.T) - 1} where it does not. Of {name} the graph states "
                f"{', '.join(stated) or 'none'}, of {', '.join(known.places)}. Add facts, or leave "
                "it out of targets."
            )
        rank = np.floor(draw * count)
        place = np.argmax(np.cumsum(allowed, axis=1) > rank[:, None], axis=1)
        chosen.append(place)
        if len(chosen) == 1:
            allowed = ~belongs
        else:
            allowed = allowed.copy()
            allowed[np.arange(len(place)), place] = False
    return np.stack(chosen, axis=1)


def _padded(numbers: Integers) -> Integers:
    """Return numbers of trays (n, K) with -1 for those that there are not, (n, MAX_TRAYS)."""
    missing = MAX_TRAYS - numbers.shape[1]
    return np.pad(numbers, ((0, 0), (0, missing)), constant_values=-1)
