"""Tidying: a plan from a graph and from what a network sees, done one object after another."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from knowarm.arrays import Floats, Integers
from knowarm.asking.answers import answer
from knowarm.errors import UserError
from knowarm.experiment.load import TrainedAgent
from knowarm.knowledge import KnowledgeGraph
from knowarm.knowledge.formats import read_graph
from knowarm.perception.config import LEVEL
from knowarm.perception.recognition import AnswerGrounding
from knowarm.perception.solving import SolvingAgent
from knowarm.questions import ObjectColour
from knowarm.world.config import EnvConfig, facets_of
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv, draw_images
from knowarm.world.tasks.sampling import Episodes
from knowarm.world.tasks.skills.chores import Chores, Tidied, only
from knowarm.world.tasks.skills.guides import Sight
from knowarm.world.tasks.state import nearest_levels

STANDARD = "objects"
"""Shipped graph that says where things belong if that of an agent does not."""
DRAWN = 4_000
"""Episodes of the task among which scenes to tidy are looked for."""
AT_ONCE = 50  # of them
MOST_STEPS = 400  # of the path of one object
TRIES = 2
NEAR_M = 0.10  # Way of an object that is still where it was tried to be taken


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
        blind: as a control, whether all images that it sees are black.

    Attributes:
        env: the scenes.
        told: the ``places`` and the colours of their trays, ``marks``, (n, K) names.

    Raises:
        UserError: the agent does not sort, or has no grounding network.
    """

    def __init__(
        self,
        trained: TrainedAgent,
        scenes: Episodes,
        graph: KnowledgeGraph | None,
        *,
        blind: bool = False,
    ) -> None:
        config = trained.config.env
        self.env = ArmVectorEnv(config, len(scenes))
        self.env.reset(options={"episodes": scenes})
        self._chores = chores_of(self.env)
        self._solver = SolvingAgent(trained.agent, config, graph)
        assert trained.network is not None
        self._network = trained.network
        self._trained = trained
        self._is_blind = blind
        self._rows = np.arange(len(scenes))
        images = self._images()
        self._seen = self._solver.look(images)
        self.told = self._chores.told
        self._number = self._chores.seen(images.numpy())
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
        belongs = self._chores.belongs(graph, self._seen.objects)
        wanted = only(belongs, self._number)
        self._wants = wanted
        self._tray = np.where(self._is_done, self._tray, -1)
        for which in range(wanted.shape[1]):
            tray = wanted[:, which]
            is_taken = (self._tray == tray[:, None]).any(axis=1)
            is_next = (tray >= 0) & ~is_taken & ~self._is_done[:, which]
            self._tray[is_next, which] = tray[is_next]

    def instruction(self, scene: int) -> str:
        """Return what is given about a scene, as "the red tray is the kitchen"."""
        return self._chores.instruct(scene)

    def close(self) -> None:
        """Close the scenes."""
        self.env.close()

    def plan(self, scene: int) -> list[Errand]:
        """Return what is planned for the objects of a scene that are not yet brought away."""
        errands = []
        colours = self.told["marks"][scene].tolist()
        places = self.told["places"][scene].tolist()
        numbers = self._number[scene].tolist()
        for which in np.flatnonzero(~self._is_done[scene]).tolist():
            facet = self.facet(scene, which)
            wanted = self._wants[scene, which]
            if wanted < 0:
                why = "the graph does not say at which one of these places it belongs"
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
        return self._chores.judge(graph)

    def _facts(self, facet: ObjectColour, place: str) -> tuple[str, ...]:
        """Return the evidence that an object belongs at a place."""
        assert self._graph is not None
        question = f"{self._chores.relation} {place}"
        return tuple(answer(self._graph, [facet], question).evidence.get(facet, ()))

    def _images(self) -> Tensor:
        """Draw the scenes as the agent sees them, (n, H, W, 3)."""
        images = draw_images(self.env.renderer, self.env.running).copy()
        if self._is_blind:
            images[:] = 0
        return torch.from_numpy(images)

    def _bring(
        self, ids: Integers, which: Integers, on_step: Callable[[], None]
    ) -> None:
        """Bring one object of each of some scenes (k,) to its tray, and go back."""
        seen = self._seen
        count = seen.objects.shape[1]
        order = np.argsort(np.arange(count) != which[:, None], axis=1, kind="stable")
        rows = ids[:, None]
        is_away = self._is_done & ~self._is_left
        places = np.where(is_away[..., None], self._destination(), seen.places)
        sight = Sight(
            joints=self.env.joint_positions[ids],
            position=seen.position[ids, which],
            matrix=seen.matrix[ids, which],
            objects=seen.objects[rows, order],
            places=places[rows, order],
            destination=self._destination()[ids, which],
        )
        path = self._chores.guide.path(sight)
        nobody = np.zeros(len(self._rows), bool)
        actions = np.zeros((len(self._rows), self.env.scene.num_joints), np.int64)
        for _ in range(MOST_STEPS):
            targets = self.env.running.joint_targets[ids]
            actions[ids] = nearest_levels(path.error(targets))
            if path.has_ended(targets).all():
                break
            self.env.advance(actions, nobody)
            on_step()

    def _destination(self) -> Floats:
        """Return where each object is put, (n, m, 2) [m]."""
        return self._chores.spots[self._tray]

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


def chores_of(env: ArmVectorEnv) -> Chores:
    """Return what there is to do with all objects of scenes that start.

    Raises:
        UserError: the task is not done with several.
    """
    task = env.config.task
    chores = task.skill.chores(env.running, task.asked)
    if chores is None:
        raise UserError(
            "Tidying needs an agent that sorts, such as "
            f"zoo/tiago-choose-sort-answers-seen; the task of this one is {task.name!r}."
        )
    return chores


def join_scenes(scenes: Sequence[Episodes]) -> Episodes:
    """Join episodes one after the other."""
    fields = {}
    for name in vars(scenes[0]):
        fields[name] = np.concatenate([getattr(scene, name) for scene in scenes])
    return Episodes(**fields)


def standard_graph(trained: TrainedAgent) -> KnowledgeGraph:
    """Return the graph that says where things belong in an agent's task."""
    env = trained.config.env
    graph = env.task.asked.answering_graph(facets_of(env))
    if graph is None:
        graph = read_graph(STANDARD)
    return graph


def scenes_to_tidy(config: EnvConfig, seed: int = 0) -> Iterator[Episodes]:
    """Yield scenes in which an object belongs on each tray and the others on none, one by one.

    They are among the evaluation episodes of a sorting task, in their order.
    """
    episodes = evaluation_episodes(config, DRAWN, seed)
    with closing(ArmVectorEnv(config, AT_ONCE)) as env:
        for first in range(0, DRAWN, AT_ONCE):
            some = episodes[first : first + AT_ONCE]
            env.reset(options={"episodes": some})
            for number in np.flatnonzero(chores_of(env).fits()):
                yield some[number : number + 1]
