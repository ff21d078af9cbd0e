"""Questions to a trained agent: the graph answers, the network finds the answer, the arm moves."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from knowarm.errors import UserError
from knowarm.experiment.load import TrainedAgent
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.queries.answers import Answers, answer
from knowarm.perception.config import Unclear
from knowarm.perception.grounding import centres
from knowarm.perception.images import first_facets
from knowarm.questions import ObjectColour
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.viewing.record import Frame, record_episode

SCENES = 4_000
"""Scenes among which one is chosen that shows an answer."""


@dataclass(frozen=True, kw_only=True)
class Asked:
    """A question, its answers, where the network sees them, and what the arm did."""

    answers: Answers
    """The answers in the graph."""
    known: Mapping[str, int]
    """Number of colours in which the network knows each object."""
    scene: int
    """Number of the scene among the evaluation episodes."""
    shown: tuple[ObjectColour, ...]
    """What stands in the scene; the object that answers comes first, if one does."""
    named: tuple[ObjectColour, ...]
    """What the network names, surest first."""
    points: np.ndarray
    """Where it does, column and row in units of the image, (m, 2)."""
    heat: np.ndarray
    """Share of every place in the choice, (h, w), sum 1."""
    visible: int
    """Number of named objects that answer."""
    stopped: bool
    """Whether the arm stayed because it did not see exactly one answer."""
    reached: ObjectColour
    """What the gripper was nearest to at the end."""
    film: tuple[Frame, ...]
    """The episode."""

    @property
    def right(self) -> bool:
        """Whether the arm ended nearest to an object that answers."""
        return self.reached in self.answers.evidence

    @property
    def outcome(self) -> str:
        """What the arm did, in a sentence."""
        end, name = self.film[-1], " ".join(reversed(self.reached))
        if self.stopped:
            return f"The arm stayed: the network sees {self.visible} answers, not one."
        what = "reached" if end.success else "ended nearest to"
        verdict = "which answers" if self.right else "which does not answer"
        wanted = self.shown[0]
        grasp = "its grasp" if self.reached == wanted else f"that of the {wanted[1]} {wanted[0]}"
        return (
            f"The arm {what} the {name}, {verdict}, after {end.step} steps: "
            f"{100 * end.distance:.1f} cm and {end.angle:.0f} degrees from {grasp}."
        )

    @property
    def table(self) -> list[list[str]]:
        """Answers by object: its name, the colours in which it answers, why the first one does."""
        rows: dict[str, tuple[list[str], str]] = {}
        for (name, colour), why in self.answers.evidence.items():
            rows.setdefault(name, ([], "; ".join(why)))[0].append(colour)
        return [
            [name, "any" if len(colours) == self.known[name] else ", ".join(colours), why]
            for name, (colours, why) in rows.items()
        ]


class Asker:
    """Asks a trained agent; scenes are drawn once.

    Args:
        trained: an agent of the choose task with a grounding network.
        seed: seed of the scenes.
        names: names of objects in graphs, as of `answer`.
    """

    def __init__(
        self, trained: TrainedAgent, seed: int = 0, names: Mapping[str, str] | None = None
    ) -> None:
        if trained.network is None:
            raise UserError(
                f"The agent {trained.config.agent!r} has no grounding network, which finds "
                "answers in the image. Ask a run such as zoo/irb120-choose-subgraph-fast."
            )
        self.trained, self.facets = trained, trained.network.spec.facets
        self._network, self._names = trained.network, names
        self._env = ArmVectorEnv(trained.config.env, 1)
        self._scenes = evaluation_episodes(self._env.config, SCENES, seed)
        first = first_facets(self._env.scene, trained.network.spec)
        self._shown = first[self._scenes.objects] + self._scenes.colours

    def close(self) -> None:
        """Close the environment."""
        self._env.close()

    def answers(self, graph: KnowledgeGraph, question: str) -> Answers:
        """Answer a question by a graph, among all that the network knows."""
        return answer(graph, self.facets, question, self._names)

    def scene(self, answers: Sequence[Answers]) -> int:
        """Return the first scene in which one object answers, another one for each of several.

        If no scene shows other ones, the first in which one object gives the last answer, and the
        answers differ.

        Raises:
            UserError: there is none.
        """
        shown = np.stack([each.satisfies[self._shown] for each in answers])  # (a, N, m)
        one = shown.sum(2) == 1
        fits = one.all(0) & (shown.sum(0) <= 1).all(1)
        if not fits.any():
            fits = one[-1] & (shown != shown[-1]).any((0, 2))
        if not fits.any():
            named = {self.facets[f][0] for f in np.flatnonzero(answers[-1].satisfies)}
            if not named & {self.facets[f][0] for f in np.unique(self._shown)}:
                raise UserError(
                    f"No scene shows what answers {answers[-1].question!r}: "
                    f"{', '.join(sorted(named))}. The scenes show what this run was trained with; "
                    "ask for another object."
                )
            raise UserError(
                f"In none of {SCENES:,} scenes does exactly one object answer "
                f"{answers[-1].question!r}"
                + (", another one than before the edit. " if len(answers) > 1 else ". ")
                + "Ask a question with other answers, or give the number of a scene."
            )
        return int(fits.argmax())

    def ask(self, answers: Answers, scene: int, unclear: Unclear = "guess") -> Asked:
        """Play a scene with an agent that looks for the answers."""
        if not 0 <= scene < SCENES:
            raise UserError(f"The scene must be 0 to {SCENES - 1}, got {scene}.")
        episode, shown = self._scenes[scene : scene + 1], self._shown[scene]
        order = np.argsort(~answers.satisfies[shown], kind="stable")  # an answer first
        names = ("objects", "colours", "positions")
        episode = replace(episode, **{name: getattr(episode, name)[:, order] for name in names})
        agent = self.trained.answering(answers.satisfies[None])
        agent.unclear = unclear
        film = record_episode(agent, self._env, episode)
        infos = self._env.config.task.infos(self._env.running)
        nearest = int(np.flatnonzero(infos["objects"][0] == infos["reached_object"][0])[0])
        with torch.inference_mode():
            image = torch.as_tensor(film[0].policy)[None]
            seen = agent.recognition.see(image, agent.recognition.knowledge)
        side = int(seen.scores.shape[1] ** 0.5)
        size = self._network.spec.image_size
        return Asked(
            answers=answers,
            known=Counter(name for name, _ in self.facets),
            scene=scene,
            shown=tuple(self.facets[f] for f in shown[order]),
            named=tuple(self.facets[f] for f in seen.named[0].tolist()),
            points=(centres(size)[seen.places[0]] / size).numpy(),
            heat=seen.scores[0].softmax(0).reshape(side, side).numpy(),
            visible=int(seen.visible[0]),
            stopped=unclear == "stop" and int(seen.visible[0]) != 1,
            reached=self.facets[shown[order][nearest]],
            film=tuple(film),
        )
