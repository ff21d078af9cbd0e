"""Questions to a trained agent: the graph answers, the network finds the answer, the arm moves."""

from collections.abc import Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from functools import cached_property
from itertools import compress
from pathlib import Path
from threading import Lock
from typing import get_args

import numpy as np
import torch
from scipy.spatial.distance import pdist

from knowarm.asking.answers import Answers, Words, answer, reading, words
from knowarm.asking.destinations import read_destination
from knowarm.asking.judgements import Place
from knowarm.asking.outcome import Asked
from knowarm.asking.quotes import condition
from knowarm.errors import UserError, unknown_name
from knowarm.experiment.knows import read_known_graph
from knowarm.experiment.load import TrainedAgent, load_agent
from knowarm.knowledge.formats import read_graph
from knowarm.knowledge.graph.edits import edited
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.perception.config import LEVEL, Unclear
from knowarm.perception.grounding import centres
from knowarm.perception.images import first_facets, pixels_of
from knowarm.perception.recognition import AnswerGrounding, SeenAnswers
from knowarm.perception.solving import SeeingAgent
from knowarm.questions import COLOUR_RELATION, ObjectColour
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.tasks.reward import is_success
from knowarm.world.tasks.sampling import Episodes
from knowarm.world.viewing.record import record_episode

EXAMPLES = 6
"""Most questions given as examples."""
IN_WORDS = "something to drink from that is not blue"
"""The first of them, where a graph answers it."""
SCENES = 4_000
"""Scenes among which one is chosen that shows an answer."""
LOOKED_AT = 60
"""Of those that show an answer: how many are looked at for a clear one."""
APART = 0.1
"""Smallest distance of objects in the image of a clear scene, as a share of its side."""
SCENES_WITH_TRAY = 200
"""Those that are looked at for one with a tray that a question names."""
SCENES_WITH_PLACES = 400
"""Those of them that are tried for a question on where things stand."""


class Asker:
    """Asks a trained agent many questions; scenes are drawn once. The arguments are of `ask`."""

    def __init__(
        self,
        trained: TrainedAgent,
        graph: KnowledgeGraph | Path | str | None = None,
        *,
        seed: int = 0,
        names: Mapping[str, str] | None = None,
        level: float = LEVEL,
    ) -> None:
        if trained.network is None:
            raise UserError(
                f"The agent {trained.config.agent!r} has no grounding network, which finds "
                "answers in the image. Ask a run such as zoo/irb120-choose-answers-fast."
            )
        self.trained = trained
        self._spec = trained.network.spec
        self.facets = self._spec.facets
        self._names = names
        self._level = level
        if graph is None:
            graph = read_known_graph(trained.config.knows)
            assert graph is not None  # of an agent with a grounding network
        if not isinstance(graph, KnowledgeGraph):
            graph = read_graph(graph)
        self.graph = graph
        env = trained.config.env
        skill = env.task.skill.without_destination()  # the question decides
        env = replace(env, task=replace(env.task, skill=skill))
        self._env = ArmVectorEnv(env, 1)
        self._playing = Lock()  # of the environment, which threads share
        self._scenes = evaluation_episodes(self._env.config, SCENES, seed)
        first = first_facets(self._env.scene, self._spec)
        # Facets of each scene, (N, m): those of an object follow each other, one per colour.
        self._shown = first[self._scenes.objects] + self._scenes.colours
        self._facets_shown = self._named(np.unique(self._shown))

    def _named(self, indices: np.ndarray) -> tuple[ObjectColour, ...]:
        return tuple(self.facets[index] for index in indices)

    @cached_property
    def has_chores(self) -> bool:
        """Whether the agent can tidy."""
        task = self._env.config.task
        return task.skill.chores(self._env.running, task.asked) is not None

    def close(self) -> None:
        """Close the environment."""
        self._env.close()

    def ask(
        self,
        question: str,
        edit: Sequence[str] = (),
        scene: int | None = None,
        unclear: Unclear = "seen",
    ) -> Asked:
        """Answer a question and play a scene; see `ask`."""
        if self._env.config.task.skill.tells_facts:
            destination = read_destination(question)
            if destination is not None:
                what, where, is_sure = destination
                try:
                    return self._ask(what, edit, scene, unclear, where)
                except UserError:
                    if is_sure or not self._is_understood(question):
                        raise
        return self._ask(question, edit, scene, unclear)

    def _is_understood(self, question: str) -> bool:
        """Return whether a question can be read, as one that names no destination."""
        with suppress(UserError):
            return bool(reading(self.graph, self.facets, question, self._names))
        return False

    def _ask(
        self,
        question: str,
        edit: Sequence[str],
        scene: int | None,
        unclear: Unclear,
        where: str = "",
    ) -> Asked:
        """Answer and play; ``where`` names where the object has to be put."""
        answers = [self.answers(question, edit)]
        if scene is None and edit:
            # Without the edits the question may have no answer
            with suppress(UserError):
                before = self.answers(question)
                if (before.satisfies != answers[0].satisfies).any():
                    answers.insert(0, before)
        scenes = self.scenes(answers) if scene is None else [scene]
        with self._playing:
            if where:
                scenes = self._with_tray(answers[-1], scenes, where)
            if scene is not None:
                return self.play(answers[-1], scene, unclear, where=where)
            failed = 0
            for number in scenes[:LOOKED_AT]:
                if self._is_clear(answers[-1], number):
                    asked = self.play(answers[-1], number, unclear, where=where)
                    if asked.succeeded:
                        return replace(asked, selection=_selection(failed))
                    failed += 1
            asked = self.play(answers[-1], scenes[0], unclear, where=where)
            looked_at = len(scenes[:LOOKED_AT])
            selection = (
                f"The scene is the first with an answer: of {looked_at} that were looked at, the "
                f"arm succeeds in none that is clear ({failed} tried)."
            )
            return replace(asked, selection=selection)

    def _with_tray(
        self, answers: Answers, scenes: Sequence[int], where: str
    ) -> list[int]:
        """Return the scenes of some in which a tray or its place has a name.

        Raises:
            UserError: there is none; it says what trays there are in the first.
        """
        running = self._env.running
        task = self._env.config.task
        fitting = []
        for scene in scenes[:SCENES_WITH_TRAY]:
            self._env.reset(options={"episodes": self._episode(answers, scene)})
            if task.skill.sent(running, task.asked, 0, where) is not None:
                fitting.append(scene)
        if not fitting:
            self._env.reset(options={"episodes": self._episode(answers, scenes[0])})
            raise UserError(
                f"There is no tray {where!r}. In scene {scenes[0]} "
                f"{task.skill.instruct(running, task.asked, 0)}. Name one of these trays, its "
                "place, or another scene."
            )
        return fitting

    def _episode(self, answers: Answers, scene: int) -> Episodes:
        """Return the episode of a scene, in which an object that answers is the one meant."""
        _check_scene(scene)
        truth = self._truth(answers, scene)
        order = np.argsort(~truth.satisfies[self._shown[scene]], kind="stable")
        episode = self._scenes[scene : scene + 1]
        by_object = ("objects", "names", "colours", "positions")
        ordered = {name: vars(episode)[name][:, order] for name in by_object}
        return replace(episode, **ordered)

    def answers(self, question: str, edit: Sequence[str] = ()) -> Answers:
        """Answer a question by the graph with edits, among all that the network knows."""
        return answer(edited(self.graph, edit), self.facets, question, self._names)

    @cached_property
    def thresholds(self) -> torch.Tensor:
        """Likelihoods from which a visible object counts as an answer, by facet, (F,)."""
        return self.trained.thresholds(self._level)

    @cached_property
    def seen(self) -> list[str]:
        """The objects that scenes show; the network may know more."""
        return sorted({name for name, _ in self._facets_shown})

    @cached_property
    def unseen(self) -> list[str]:
        """The objects that the network knows and scenes never show."""
        return sorted({name for name, _ in self.facets}.difference(self.seen))

    @cached_property
    def words(self) -> Words:
        """What can be asked: by relation and value, the objects that scenes show."""
        return words(self.graph, self._facets_shown, self._names)

    @cached_property
    def examples(self) -> list[str]:
        """Questions that a scene answers by one object, of several relations."""
        facts = []
        for relation, values in self.words.items():
            if relation != COLOUR_RELATION:
                most_common = max(values, key=lambda value: len(values[value]))
                facts.append(condition(relation, most_common))
        questions = [IN_WORDS]
        if facts:
            questions.append(f"{facts[0]} and not hasColor blue")
        if len(facts) > 2:
            questions.append(f"{facts[1]} or {facts[2]}")
        questions += facts
        answered = []
        for question in questions:
            with suppress(UserError):
                self.scene([self.answers(question)])
                answered.append(question)
        return answered[:EXAMPLES]

    def look(self, scene: int) -> tuple[np.ndarray, tuple[ObjectColour, ...]]:
        """Return the image of a scene, (480, 480, 3) uint8, and what stands in it."""
        _check_scene(scene)
        with self._playing:
            self._env.reset(options={"episodes": self._scenes[scene : scene + 1]})
            return self._env.render()[0], self._named(self._shown[scene])

    def scene(self, answers: Sequence[Answers]) -> int:
        """Return the first of `scenes`."""
        return self.scenes(answers)[0]

    def scenes(self, answers: Sequence[Answers]) -> list[int]:
        """Return the scenes in which one object answers, another one for each of several.

        If no scene shows other ones, those in which one object gives the last answer, and the
        answers differ.

        Raises:
            UserError: there is none.
        """
        satisfies = np.array(list(map(self._satisfied, answers)))  # (a, N, m)
        has_one = satisfies.sum(2) == 1
        fits = has_one.all(0) & (satisfies.sum(0) <= 1).all(1)
        if not fits.any():
            fits = has_one[-1] & (satisfies != satisfies[-1]).any((0, 2))
        if fits.any():
            return fits.nonzero()[0].tolist()
        question = answers[-1].question
        names = sorted({name for name, _ in answers[-1].judgements})
        if not set(names) & set(self.seen):
            raise UserError(
                f"No scene shows what answers {question!r}: {', '.join(names)}. The scenes show "
                f"what this run was trained with: {', '.join(self.seen)}. Ask for one of these."
            )
        tried = SCENES_WITH_PLACES if answers[-1].has_places else SCENES
        other = ""
        if len(answers) > 1:
            other = ", another one than before the edit"
        raise UserError(
            f"In none of {tried:,} scenes does exactly one object answer {question!r}{other}. "
            "Ask a question with other answers, or give the number of a scene."
        )

    def _is_clear(self, answers: Answers, scene: int) -> bool:
        """Return whether objects stand apart, and the network sees the one that answers alone."""
        size = self._spec.image_size
        pixels = pixels_of(self._env.scene, self._scenes.positions[scene], size)
        if pdist(pixels).min(initial=np.inf) < APART * size:
            return False
        shown = self._named(self._shown[scene])
        right = self._truth(answers, scene).evidence
        images, _ = self._env.reset(
            options={"episodes": self._scenes[scene : scene + 1]}
        )
        image = torch.from_numpy(images)
        _, wanted = self._decide(answers, image)
        seen = self._see(image, wanted)
        named = self._named(seen.named[0].numpy())
        may_answer = seen.candidates(self.thresholds)[0].tolist()
        candidates = set(compress(named, may_answer))
        return set(named) == set(shown) and candidates == right.keys() & set(shown)

    def _satisfied(self, answers: Answers) -> np.ndarray:
        """Return whether what stands in each scene answers, (N, m) bool.

        Where places decide, only the first `SCENES_WITH_PLACES` are looked at.
        """
        if not answers.has_places:
            return np.asarray(answers.satisfies[self._shown])
        satisfies = np.zeros(self._shown.shape, bool)
        for scene, shown in enumerate(self._shown[:SCENES_WITH_PLACES]):
            satisfies[scene] = self._truth(answers, scene).satisfies[shown]
        return satisfies

    def _truth(self, answers: Answers, scene: int) -> Answers:
        """Return the answers by where the objects of a scene stand in truth."""
        if not answers.has_places:
            return answers
        size = self._spec.image_size
        pixels = pixels_of(self._env.scene, self._scenes.positions[scene], size)
        return answers.within(_placed(self._named(self._shown[scene]), pixels / size))

    def _decide(
        self, answers: Answers, image: torch.Tensor
    ) -> tuple[Answers, np.ndarray]:
        """Return the answers in an image (1, H, W, 3), and how much each facet is wanted, (F,).

        What the network names is where it sees it. Answers that the graph states are wanted before
        those that rest on what it does not say, if one of them is seen.
        """
        if answers.has_places:
            seen = self._see(image, np.ones(len(self.facets)))
            named = self._named(seen.named[0].numpy())
            answers = answers.within(_placed(named, self._points(seen)))
        stated = answers.stated
        if stated.any() and (stated < answers.degrees).any():
            seen = self._see(image, stated)
            if seen.candidates(self.thresholds).any():
                return answers, stated
        return answers, answers.degrees

    def _see(self, image: torch.Tensor, wanted: np.ndarray) -> SeenAnswers:
        """Find what is wanted (F,) in an image (1, H, W, 3)."""
        rows = wanted[None].astype(np.float32)
        recognition = self.trained.answering(rows).recognition
        assert isinstance(recognition, AnswerGrounding)
        with torch.inference_mode():
            return recognition.see(image, torch.from_numpy(rows))

    def _points(self, seen: SeenAnswers) -> np.ndarray:
        """Return where the network sees what it names, column and row, (m, 2) of 0 to 1."""
        size = self._spec.image_size
        return np.asarray(centres(size)[seen.places[0]] / size)

    def play(
        self,
        answers: Answers,
        scene: int,
        unclear: Unclear = "seen",
        picked: ObjectColour | None = None,
        where: str = "",
    ) -> Asked:
        """Play a scene with an agent that looks for the answers, or for the one that is picked.

        ``where`` names where the object has to be put, in place of where it belongs.
        """
        episode = self._episode(answers, scene)
        if unclear not in get_args(Unclear):
            raise unknown_name("value of unclear", unclear, get_args(Unclear))
        truth = self._truth(answers, scene)
        shown = self._shown[scene]
        order = np.argsort(~truth.satisfies[shown], kind="stable")  # an answer first
        shown = shown[order]
        images, _ = self._env.reset(options={"episodes": episode})
        image = torch.from_numpy(images)
        answers, wanted = self._decide(answers, image)
        seen = self._see(image, wanted)
        if picked is not None:
            wanted = np.array([facet == picked for facet in self.facets])
            unclear = "guess"
        answering = self.trained.answering(
            wanted[None], unclear=unclear, thresholds=self.thresholds
        )
        end = self._env.running
        task = end.config.task
        graph = answers.graph
        if where:
            graph = task.skill.sent(end, task.asked, 0, where)
        assert graph is not None
        agent = self.trained.acting(answering, graph, guesses=False)
        film = record_episode(agent, self._env, episode)
        infos = task.infos(end)
        is_reached = infos["objects"] == infos["reached_object"][:, None]
        nearest = is_reached.argmax(1)
        distance, angle = end.measure_object(nearest)
        is_near = bool(is_success(distance, angle, *end.limits)[0])
        result = task.skill.result(end, task.asked, 0)
        is_solved = bool(task.skill.solved(end, task.asked, graph)[0])
        named = self._named(seen.named[0].numpy())
        may_answer = seen.candidates(self.thresholds)[0].tolist()
        side = int(seen.scores.shape[1] ** 0.5)
        return Asked(
            answers=answers,
            truth=truth,
            scene=scene,
            shown=self._named(shown),
            named=named,
            points=self._points(seen),
            heat=seen.scores[0].softmax(0).reshape(side, side).numpy(),
            candidates=tuple(compress(named, may_answer)),
            stopped=not answering.moves[0],
            lacks_place=isinstance(agent, SeeingAgent) and bool(agent.lacks_place[0]),
            reached=self.facets[shown[nearest[0]]],
            distance=float(distance[0]),
            angle=float(angle[0]),
            within=is_solved if result else is_near,
            film=tuple(film),
            result=result,
            told=task.skill.instruct(end, task.asked, 0),
            where=where,
        )


def ask(
    agent: TrainedAgent | Path | str,
    question: str,
    *,
    graph: KnowledgeGraph | Path | str | None = None,
    edit: Sequence[str] | str = (),
    scene: int | None = None,
    seed: int = 0,
    names: Mapping[str, str] | None = None,
    unclear: Unclear = "seen",
    level: float = LEVEL,
) -> Asked:
    """Ask a trained agent: the graph answers, the network finds the answer, the arm goes there.

    Args:
        agent: a run of the choose task with a grounding network, such as
            ``zoo/irb120-choose-answers-fast``, or what `load_agent` returned.
        question: such as "usedFor drinking and not hasColor blue", or SPARQL; of an agent that
            sorts also "put the mug on the blue tray".
        graph: another graph than the run's: a file, or the name of a shipped one.
        edit: a change of the graph, such as "- mug usedFor drinking", or several. The scene is
            then one with another answer than without them, unless ``scene`` is given.
        scene: number of the scene; None takes, of the first 60 in which exactly one object
            answers, the first that is clear: objects stand apart, the network sees the answer
            alone, and the arm reaches it. If none is, the first.
        seed: seed of the scenes.
        names: the graph's names for objects, such as ``{"mug": "CoffeeMug"}``.
        unclear: if the network sees no answer, or several: go to the most likely place ("guess"),
            do so if it sees any ("seen"), or stay ("stop", "ask"). `Asked.candidates` says which
            it sees.
        level: how often the object that is meant shall be among those; calibrated on images that
            training did not see.

    Returns:
        Answers with their evidence, what the network names, and what the arm did.

    Raises:
        UserError: a question, edit, graph or scene that does not fit the agent.
    """
    if not isinstance(agent, TrainedAgent):
        agent = load_agent(agent)
    if isinstance(edit, str):
        edit = [edit]
    with closing(Asker(agent, graph, seed=seed, names=names, level=level)) as asker:
        return asker.ask(question, edit, scene, unclear)


def _selection(failed: int) -> str:
    """Say that a scene is the first clear one in which the arm succeeds, after some failures."""
    chosen = "The scene is the first in which objects stand apart, the network names them rightly"
    if not failed:
        return f"{chosen} and the arm succeeds."
    return f"{chosen} and the arm succeeds; it failed in {failed} before."


def _placed(
    facets: Sequence[ObjectColour], points: np.ndarray | torch.Tensor
) -> dict[ObjectColour, Place]:
    """Return the places (m, 2) of facets by facet."""
    return dict(zip(facets, map(tuple, points.tolist()), strict=True))


def _check_scene(scene: int) -> None:
    if scene not in range(SCENES):
        raise UserError(f"The scene must be 0 to {SCENES - 1}, got {scene!r}.")
