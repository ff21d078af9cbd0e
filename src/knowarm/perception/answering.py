"""Answer grounding: the graph says which facets answer a query, a network says where they stand.

Every place of the image has a score per facet, its object's logit plus its colour's. The place
whose log-sum-exp over the answering facets is largest holds the answer, and its features give the
grasp frame. Nothing of this is trained on queries.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from knowarm.perception.agent import PerceivingAgent
from knowarm.perception.config import Unclear
from knowarm.perception.grounding import GroundingNetwork
from knowarm.perception.module import BATCH, GoalPredictor, PerceptionModule
from knowarm.questions import ObjectColour, number_objects, number_parts
from knowarm.world.config import EnvConfig
from knowarm.world.tasks.state import EpisodeState


class SeenAnswers(NamedTuple):
    """What answer grounding finds in n images."""

    frames: Tensor
    """Grasp frame at the chosen place, (n, 9) float32."""
    scores: Tensor
    """Log-sum-exp over the answering facets at every place, (n, P) float32."""
    named: Tensor
    """Facets of the m visible objects, surest first, (n, m) int64."""
    places: Tensor
    """Where they stand, (n, m) int64."""
    visible: Tensor
    """Number of the named facets that answer, (n,) int64."""


class AnswerGrounding(PerceptionModule):
    """Grounding by the answers of a graph, with the weights of a grounding network.

    Args:
        network: names objects and colours at places, and predicts grasp frames.
        answers: (Q, F) bool or float32, whether each facet of the network answers each query.
    """

    GOAL, FORMAT = GroundingNetwork.GOAL, GroundingNetwork.FORMAT

    knowledge: Tensor
    """(Q, F) float32 buffer, 1 where a facet answers; may be replaced by other answers."""

    def __init__(self, network: GroundingNetwork, answers: np.ndarray | Tensor) -> None:
        super().__init__(network.spec, network.encoder)
        self.network = network
        self.register_buffer("knowledge", torch.as_tensor(answers, dtype=torch.float32).clone())

    def predictor(self, env: EnvConfig, facets: tuple[ObjectColour, ...]) -> GoalPredictor:
        """As `PerceptionModule.predictor`; a goal is a grasp frame."""
        self.spec.check_fits(env, ())
        return self

    def true_goals(self, episodes: EpisodeState, ids: NDArray[np.int64]) -> Tensor:
        """As `GroundingNetwork.true_goals`."""
        return self.network.true_goals(episodes, ids)

    def forward(self, images: Tensor, queries: Tensor) -> Tensor:
        """Predict the grasp frames (n, 9) of the objects that answer; see `GoalPredictor`."""
        return self.locate(images, self.knowledge[queries])

    def see(self, images: Tensor, queries: Tensor) -> SeenAnswers:
        """Find the answers to queries (n,) int64 in images (n, H, W, 3) uint8."""
        answers = self.knowledge[queries] > 0
        frames, scores, by_place = self._find(images, answers)
        named, places = self._name(by_place)
        return SeenAnswers(frames, scores, named, places, answers.gather(1, named).sum(1))

    def place_scores(self, images: Tensor, queries: Tensor) -> Tensor:
        """As `GroundingNetwork.place_scores`."""
        return self._find(images, self.knowledge[queries] > 0)[1]

    def locate(self, images: Tensor, knowledge: Tensor) -> Tensor:
        """As `forward`, with the answers to the queries, (n, F) float32."""
        return self._find(images, knowledge > 0)[0]

    def _find(self, images: Tensor, answers: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return frames (n, 9), scores (n, P) and those by facet (n, F, P) for answers (n, F)."""
        features = self.encoder.features(images)
        objects, colours = self.encoder.logits(features)
        object_of, colour_of = self.encoder.facet_parts
        by_place = objects[:, object_of] + colours[:, colour_of]
        # Where nothing answers, every facet counts, so that there is a place to guess.
        counted = answers | ~answers.any(1, keepdim=True)
        answering = by_place.masked_fill(~counted[:, :, None], -torch.inf)
        scores = answering.logsumexp(1)
        place = scores.argmax(1)
        at_place = place[:, None, None].expand(-1, answering.shape[1], 1)
        cell = self.network.cells(place, answering.gather(2, at_place)[..., 0].argmax(1))
        return self.network.frames(features, cell[:, None])[:, 0], scores, by_place

    def _name(self, by_place: Tensor) -> tuple[Tensor, Tensor]:
        """Name m different objects at different places, best scores (n, F, P) first, (n, m) each.

        With this network it is right more often than the m best facets of the image as a whole. All
        parts of an object are named at the best place of any.
        """
        rows, left = torch.arange(len(by_place)), by_place.clone()
        parts = torch.from_numpy(number_parts(self.spec.facets))
        objects = torch.from_numpy(number_objects(self.spec.facets, whole=True))
        named = []
        for _ in range(self.spec.objects // self.network.parts):
            best = left.flatten(1).argmax(1)
            facet, place = best // left.shape[2], best % left.shape[2]
            named.append((parts[facet], place[:, None].expand(-1, parts.shape[1])))
            left[rows, :, place] = -torch.inf
            left.masked_fill_((objects == objects[facet][:, None])[:, :, None], -torch.inf)
        facets, places = (torch.cat(each, dim=1) for each in zip(*named, strict=True))
        return facets, places

    def to_bytes(self) -> bytes:
        """As `PerceptionModule.to_bytes`: the network, since answers come from a graph."""
        return self.network.to_bytes()

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy with the answers."""
        return type(self), (self.network, self.knowledge)


class AnsweringAgent(PerceivingAgent):
    """Policy agent that moves to the object that answers by a graph, and says if it sees none.

    Args:
        module: the answers and where they stand.
        unclear: what to do where no visible object answers, or several do.

    Attributes:
        visible_answers: how many visible objects answer in each environment, (n,) int64.
    """

    module: AnswerGrounding
    visible_answers: np.ndarray

    def __init__(
        self, module: AnswerGrounding, *arguments: Any, unclear: Unclear = "guess", **options: Any
    ) -> None:
        super().__init__(module, *arguments, **options)
        self.unclear = unclear
        self.log: list[np.ndarray] = []
        """``visible_answers`` of every reset, in order."""

    def recognize(self, images: Tensor) -> Tensor:
        """As `PerceivingAgent.recognize`; counts the visible answers in the images."""
        parts = zip(images.split(BATCH), self.rows.split(BATCH), strict=True)
        seen = [self.module.see(*part) for part in parts]
        self.visible_answers = torch.cat([each.visible for each in seen]).numpy()
        self.log.append(self.visible_answers)
        return torch.cat([each.frames for each in seen])

    def act(self, observations: Mapping[str, np.ndarray]) -> np.ndarray:
        """As `PolicyAgent.act`; with ``unclear`` "stop" nothing moves without exactly one answer.

        Action 0 adds nothing to the joint targets.
        """
        actions = super().act(observations)
        if self.unclear == "stop":
            actions = np.where((self.visible_answers == 1)[:, None], actions, 0)
        return actions
