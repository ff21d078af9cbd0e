"""Tidying: a plan from a graph and from what a network sees, done one object after another."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import torch
from torch import Tensor

from knowarm.arrays import Floats, Integers, Mask
from knowarm.asking.answers import answer
from knowarm.errors import UserError
from knowarm.experiment.load import TrainedAgent
from knowarm.knowledge import KnowledgeGraph
from knowarm.perception.answering import AnswerGrounding
from knowarm.perception.config import LEVEL
from knowarm.perception.solving import SolvingAgent
from knowarm.questions import ObjectColour
from knowarm.world.config import EnvConfig, robot_of
from knowarm.world.envs.base import draw_images
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.running import joint_increments
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.tasks.sampling import Episodes
from knowarm.world.tasks.skills.guides import Sight
from knowarm.world.tasks.skills.lift.model import LiftScene
from knowarm.world.tasks.skills.lift.simulator import LiftSimulator
from knowarm.world.tasks.skills.place.guide import ReturningGuide
from knowarm.world.tasks.skills.place.tray import centres_m
from knowarm.world.tasks.skills.sort.belongings import belongings, true_belongings
from knowarm.world.tasks.skills.sort.looking import trays_by_colour
from knowarm.world.tasks.skills.sort.sort import Sort
from knowarm.world.tasks.state import EpisodeState, nearest_levels

DRAWN = 4_000
"""Episodes of the task among which scenes to tidy are looked for."""
AT_ONCE = 50  # of them
MOST_STEPS = 400  # of the way of one object
TRIES = 2
NEAR_M = 0.10  # Way of an object that is still where it was tried to be taken
APART_M = 0.025
MOVED_M = 0.03  # Way after which an object that should stay counts as moved


@dataclass(frozen=True, kw_only=True)
class Errand:
    """What a plan does with one object that the network names."""

    facet: ObjectColour
    """The object and its colour."""
    tray: str = ""
    """Colour of the tray to which it is brought; empty: it stays."""
    place: str = ""
    """The place for which the tray stands."""
    facts: tuple[str, ...] = ()
    """What of the graph says that it belongs there."""
    why: str = ""
    """Why it stays."""


@dataclass(frozen=True, kw_only=True)
class Tidied:
    """How n scenes with m objects stand."""

    belongs: Integers
    """Number of the tray on which each object belongs, or -1, (n, m)."""
    stands: Integers
    """Number of the tray on which it stands, or -1, (n, m)."""
    moved: Mask
    """Whether it has moved by 3 cm, toppled or fallen, (n, m)."""

    @property
    def in_place(self) -> Mask:
        """Whether each object that belongs on a tray stands there, (n, m); others do not count."""
        return (self.belongs >= 0) & (self.belongs == self.stands)

    @property
    def is_tidy(self) -> Mask:
        """Whether all of them do in a scene, (n,)."""
        is_out = (self.belongs >= 0) & ~self.in_place
        return np.asarray(~is_out.any(axis=1))

    @property
    def wrong_tray(self) -> Mask:
        """Whether each object stands on another tray than its own, (n, m)."""
        return (self.stands >= 0) & (self.stands != self.belongs)

    @property
    def disturbed(self) -> Mask:
        """Whether an object that should stay has moved, in each scene, (n,)."""
        return np.asarray((self.moved & (self.belongs < 0)).any(axis=1))


class Tidying:
    """n scenes, in which an arm brings objects to the trays of the places where they belong.

    A plan follows from the first image and the graph: each object that the network names goes to
    the tray of the place where the graph says that it belongs, one object to a tray, surest first.
    After each object the arm goes back and looks again: an object that is still seen within 10 cm
    of where it was is tried once more.

    Args:
        trained: an agent of a sorting task with a grounding network.
        scenes: episodes of its task, of which the questions are not asked.
        graph: what it knows of where things belong; None: nothing.

    Attributes:
        env: the scenes.
        told: which tray is which place, ``tray_places`` and ``tray_colours``, (n, K) names.

    Raises:
        UserError: the agent does not sort, or has no grounding network.
    """

    def __init__(
        self, trained: TrainedAgent, scenes: Episodes, graph: KnowledgeGraph | None
    ) -> None:
        config = trained.config.env
        self._skill = sorting(config)
        self._solver = SolvingAgent(trained.agent, config, graph)
        self._trained = trained
        self.env = ArmVectorEnv(config, len(scenes))
        self.env.reset(options={"episodes": scenes})
        assert trained.network is not None
        self._network = trained.network
        state = self._state
        self._rows = np.arange(len(scenes))
        self._start = state.positions
        scene = self.env.scene
        assert isinstance(scene, LiftScene)
        self._guide = ReturningGuide(
            scene,
            float(joint_increments(scene.robot, config).max()),
            config.success_angle_deg,
            config.ignore_roll,
        )
        self._centres = centres_m(self.env.scene.robot, least=2)
        self._spots = apart(self._centres)
        images = self._images()
        self._seen = self._solver.look(images)
        self.told = self._skill.facts(state, config.task.asked)
        self._number = trays_by_colour(
            self.env.scene, images.numpy(), self._centres, self.told["tray_colours"]
        )
        shape = self._seen.objects.shape
        self._tried = np.zeros(shape, np.int64)
        self._is_done = np.zeros(shape, bool)
        self._is_left = np.zeros(shape, bool)
        self._tray = np.full(shape, -1)  # of what is planned or done
        self.graph = graph

    @property
    def graph(self) -> KnowledgeGraph | None:
        """What the agent knows; assigning another one changes what is left of the plan."""
        return self._graph

    @graph.setter
    def graph(self, graph: KnowledgeGraph | None) -> None:
        self._graph = graph
        wanted = self._wanted(graph, self._seen.objects, self._number)
        self._wants = wanted
        self._tray = np.where(self._is_done, self._tray, -1)
        for which in range(wanted.shape[1]):
            tray = wanted[:, which]
            is_taken = (self._tray == tray[:, None]).any(axis=1)
            is_next = (tray >= 0) & ~is_taken & ~self._is_done[:, which]
            self._tray[is_next, which] = tray[is_next]

    @property
    def _state(self) -> EpisodeState[LiftSimulator]:
        """The scenes as they are."""
        return cast(EpisodeState[LiftSimulator], self.env.running)

    def instruction(self, scene: int) -> str:
        """Return what is told of a scene, as "the red tray is the kitchen"."""
        asked = self.env.config.task.asked
        return self._skill.instruct(self._state, asked, scene)

    def close(self) -> None:
        """Close the scenes."""
        self.env.close()

    def plan(self, scene: int) -> list[Errand]:
        """Return what is planned for the objects of a scene that are not yet brought away."""
        errands = []
        colours = self.told["tray_colours"][scene].tolist()
        places = self.told["tray_places"][scene].tolist()
        numbers = self._number[scene].tolist()
        for which in np.flatnonzero(~self._is_done[scene]).tolist():
            facet = self.facet(scene, which)
            wanted = self._wants[scene, which]
            if wanted < 0:
                why = "the graph says of none of these places that it belongs there"
                errands.append(Errand(facet=facet, why=why))
                continue
            told = numbers.index(wanted)
            place = places[told]
            facts = self._facts(facet, place)
            errand = Errand(facet=facet, tray=colours[told], place=place, facts=facts)
            if self._tray[scene, which] < 0:
                why = f"the {colours[told]} tray, where it belongs, takes one object"
                errand = replace(errand, tray="", why=why)
            errands.append(errand)
        return sorted(errands, key=lambda errand: errand.tray == "")

    def step(self, on_step: Callable[[], None] = lambda: None) -> Integers:
        """Bring the next object of each plan to its tray, go back and look again.

        ``on_step`` is called after each control period.

        Returns:
            Number of the object among those that the network names in each scene, or -1 where the
            plan is done, (n,).
        """
        is_open = (self._tray >= 0) & ~self._is_done
        acts = is_open.any(axis=1)
        ids = np.flatnonzero(acts)
        which = is_open.argmax(axis=1)
        if len(ids):
            self._bring(ids, which[ids], on_step)
            self._look_again(ids, which[ids])
        return np.where(acts, which, -1)

    def facet(self, scene: int, which: int) -> ObjectColour:
        """Return the object that the network names, by its number in `step`."""
        return self._network.spec.facets[self._seen.facets[scene, which]]

    def is_left(self, scene: int, which: int) -> bool:
        """Return whether an object was last seen where it was."""
        return bool(self._is_left[scene, which])

    def judge(self, graph: KnowledgeGraph) -> Tidied:
        """Tell how the scenes stand, by where a graph says that the objects belong."""
        state = self._state
        simulator = state.simulator
        belongs = self._wanted(graph, state.objects, self._true_number())
        stands = []
        moved = []
        for objects, places in zip(
            state.objects.T, self._start.transpose(1, 0, 2), strict=True
        ):
            stands.append(self._skill.trays(state, objects))
            moved.append(simulator.displacement(objects, places) > MOVED_M)
        return Tidied(
            belongs=belongs, stands=np.stack(stands, 1), moved=np.stack(moved, 1)
        )

    def _wanted(
        self, graph: KnowledgeGraph | None, objects: Integers, numbers: Integers
    ) -> Integers:
        """Return on which tray objects (n, m) belong; of no place, or of several: -1."""
        wanted = np.full(objects.shape, -1)
        if graph is None:
            return wanted
        facets = tuple((target.name, "") for target in self.env.scene.targets)
        known = belongings(graph, facets, self._skill.relation)
        for which, of_scene in enumerate(objects.T):
            belongs = known.of(of_scene, self.told["tray_places"])
            tray = numbers[self._rows, belongs.argmax(axis=1)]
            wanted[:, which] = np.where(belongs.sum(axis=1) == 1, tray, -1)
        return wanted

    def _true_number(self) -> Integers:
        """Return the number of the tray of each place that is told, (n, K)."""
        count = len(self._centres)
        places = self.env.running.memory["tray_places"][:, :count]
        return np.argsort(places, axis=1)

    def _facts(self, facet: ObjectColour, place: str) -> tuple[str, ...]:
        """Return the evidence that an object belongs at a place."""
        assert self._graph is not None
        question = f"{self._skill.relation} {place}"
        return tuple(answer(self._graph, [facet], question).evidence.get(facet, ()))

    def _images(self) -> Tensor:
        """Draw the scenes, (n, H, W, 3)."""
        return torch.from_numpy(draw_images(self.env.renderer, self.env.running).copy())

    def _bring(
        self, ids: Integers, which: Integers, on_step: Callable[[], None]
    ) -> None:
        """Bring one object of each of some scenes (k,) to its tray, and go back."""
        seen = self._seen
        count = seen.objects.shape[1]
        order = np.argsort(np.arange(count) != which[:, None], axis=1, kind="stable")
        rows = ids[:, None]
        places = np.where(self._is_done[..., None], self._destination(), seen.places)
        sight = Sight(
            joints=self.env.joint_positions[ids],
            position=seen.position[ids, which],
            matrix=seen.matrix[ids, which],
            objects=seen.objects[rows, order],
            places=places[rows, order],
            destination=self._destination()[ids, which],
        )
        way = self._guide.way(sight)
        nobody = np.zeros(len(self._rows), bool)
        actions = np.zeros((len(self._rows), self.env.scene.num_joints), np.int64)
        for _ in range(MOST_STEPS):
            targets = self.env.running.joint_targets[ids]
            actions[ids] = nearest_levels(way.error(targets))
            if way.has_ended(targets).all():
                break
            self.env.advance(actions, nobody)
            on_step()

    def _destination(self) -> Floats:
        """Return where each object is put, (n, m, 2) [m]."""
        return self._spots[self._tray]

    def _look_again(self, ids: Integers, which: Integers) -> None:
        """See whether objects of scenes (k,) are still where they were."""
        seen = self._seen
        facets = seen.facets[ids, which]
        wanted = np.zeros((len(ids), len(self._network.spec.facets)))
        wanted[np.arange(len(ids)), facets] = 1.0
        answers = torch.from_numpy(wanted.astype(np.float32))
        recognition = AnswerGrounding(self._network, answers)
        with torch.inference_mode():
            look = recognition.see(self._images()[ids], answers)
        thresholds = self._trained.thresholds(LEVEL)
        is_named = look.candidates(thresholds).numpy().any(axis=1)
        position, matrix = self._solver.poses(look.frames)
        offset = self.env.scene.grasp_position[seen.objects[ids, which], :2]
        places = position[:, :2] - offset
        # On trays, where training never showed objects, the network may see them anywhere.
        way = np.linalg.norm(places - seen.places[ids, which], axis=1)
        is_there = is_named & (way < NEAR_M)
        for array, values in (
            (seen.position, position),
            (seen.matrix, matrix),
            (seen.places, places),
        ):
            array[ids[is_there], which[is_there]] = values[is_there]
        self._tried[ids, which] += 1
        is_last = self._tried[ids, which] == TRIES
        self._is_done[ids, which] = ~is_there | is_last
        self._is_left[ids, which] = is_there


def join_scenes(scenes: Sequence[Episodes]) -> Episodes:
    """Join episodes one after the other."""
    fields = {}
    for name in vars(scenes[0]):
        fields[name] = np.concatenate([getattr(scene, name) for scene in scenes])
    return Episodes(**fields)


def apart(centres: Floats) -> Floats:
    """Return where objects are put on trays (K, 2): not in their middle, but `APART_M` from it.

    Away from the nearest other tray, so that the gripper does not touch what stands there.
    """
    offset = centres[:, None] - centres
    distance = np.linalg.norm(offset, axis=2)
    np.fill_diagonal(distance, np.inf)
    rows = np.arange(len(centres))
    nearest = distance.argmin(axis=1)
    away = offset[rows, nearest] / distance[rows, nearest, None]
    return centres + APART_M * away


def sorting(config: EnvConfig) -> Sort:
    """Return the skill of a task that sorts.

    Raises:
        UserError: it does not.
    """
    skill = config.task.skill
    if not isinstance(skill, Sort):
        raise UserError(
            "Tidying needs an agent that sorts, such as "
            f"zoo/tiago-choose-sort-answers-seen; the task of this one is {config.task.name!r}."
        )
    return skill


def scenes_to_tidy(config: EnvConfig, seed: int = 0) -> Iterator[Episodes]:
    """Yield scenes in which an object belongs on each tray and the others on none, one by one.

    They are among the evaluation episodes of a sorting task, in their order.
    """
    skill = sorting(config)
    count = len(centres_m(robot_of(config), least=2))
    episodes = evaluation_episodes(config, DRAWN, seed)
    env = ArmVectorEnv(config, AT_ONCE)
    known = true_belongings(config.task.asked, env.facets, skill.relation)
    for first in range(0, DRAWN, AT_ONCE):
        some = episodes[first : first + AT_ONCE]
        env.reset(options={"episodes": some})
        trays = env.running.memory["tray_places"][:, :count]
        belongs = known.belongs[some.objects[..., None], trays[:, None]]  # (n, m, K)
        is_once = (belongs.sum(axis=1) == 1).all(axis=1)
        is_once &= (belongs.sum(axis=2) <= 1).all(axis=1)
        for number in np.flatnonzero(is_once):
            yield some[number : number + 1]
    env.close()
