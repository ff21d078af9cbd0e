"""Answer grounding: the graph says which facets answer a query, a network says where they stand.

Every place of the image has a score per facet, its object's logit plus its colour's. The place
whose log-sum-exp over the answering facets is largest holds the answer, and its features give the
grasp frame. A facet that answers by doubtful facts has the logarithm of its probability added.
Nothing of this is trained on queries.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from knowarm.perception.agent import FrameRecognition
from knowarm.perception.config import Unclear
from knowarm.perception.grounding import BATCH
from knowarm.policy import Policy, PolicyAgent
from knowarm.questions import SURE


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
    answering: Tensor
    """Whether these facets answer, more probably than not, (n, m) bool."""
    likelihoods: Tensor
    """Probability that each facet stands there, 0 where it does not answer, (n, F, m) float32."""

    @property
    def visible(self) -> Tensor:
        """Number of the named facets that answer, (n,) int64."""
        return self.answering.sum(1)

    def candidates(self, thresholds: Tensor | None) -> Tensor:
        """Return which objects may answer, (n, m): by likelihoods, or without thresholds by name.

        ``thresholds`` (F,) are the likelihoods from which a facet alone makes a candidate; several
        facets together need shares of theirs that add up to 1.
        """
        if thresholds is None:
            return self.answering
        # 0 / 0: a threshold of 0 is always reached
        shares = (self.likelihoods / thresholds[:, None]).nan_to_num(nan=1.0)
        return shares.sum(1) >= 1


class AnswerGrounding(FrameRecognition):
    """Recognition of grasp frames by the answers of a graph, with the same grounding network.

    ``knowledge`` (rows, F) is the probability that a facet of the network answers the query of a
    row: 1 or 0, but for facts with a confidence.
    """

    def see(self, images: Tensor, knowledge: Tensor) -> SeenAnswers:
        """Find the answers to queries, as `locate`."""
        frames, scores, by_place = self._find(images, knowledge)
        named, places = self.name(by_place)
        at_place = by_place.take_along_dim(places[:, None], 2)  # (n, F, m)
        part = self.network.part_of
        is_other = part[:, None] != part[named][:, None]  # of another part, (n, F, m)
        likelihoods = at_place.masked_fill(is_other, -torch.inf).softmax(1)
        # What answers more probably than not counts; how probably decides which one is chosen.
        likelihoods *= (knowledge >= SURE)[:, :, None]
        answering = knowledge.gather(1, named) >= SURE
        return SeenAnswers(frames, scores, named, places, answering, likelihoods)

    def place_scores(self, images: Tensor, knowledge: Tensor) -> Tensor:
        """As `FrameRecognition.place_scores`."""
        return self._find(images, knowledge)[1]

    def locate(self, images: Tensor, knowledge: Tensor) -> Tensor:
        """As `FrameRecognition.locate`."""
        return self._find(images, knowledge)[0]

    def make_agent(self, policy: Policy, **options: Any) -> PolicyAgent:
        """Make an agent that acts on these frames; options as `AnsweringAgent`."""
        return AnsweringAgent(policy, self, **options)

    def _find(self, images: Tensor, knowledge: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return frames (n, 9), scores (n, P) and those by facet (n, F, P) for answers (n, F)."""
        encoder = self.network.encoder
        features = encoder.features(images)
        by_place = encoder.scores_by_place(features)
        # Where nothing answers, every facet counts, so that there is a place to guess.
        counted = torch.where((knowledge > 0).any(1, keepdim=True), knowledge, 1.0)
        answering = by_place + counted.log()[:, :, None]
        scores = answering.logsumexp(1)
        place = scores.argmax(1)
        index = place[:, None, None].expand(-1, answering.shape[1], 1)
        facet = answering.gather(2, index).squeeze(2).argmax(1)
        cell = self.network.cells(place, facet)
        frames = self.network.frames(features, cell[:, None])[:, 0]
        return frames, scores, by_place


class AnsweringAgent(PolicyAgent):
    """Policy agent that moves to the object that answers by a graph, and says if it sees none.

    Its `notes` are "places", where the named objects stand, and "candidates", which of them may
    answer, (n, m) each.

    Args:
        policy: as `PolicyAgent`.
        recognition: the answers and where they stand.
        unclear: what to do where no visible object answers, or several do.
        thresholds: likelihoods from which a visible object counts as an answer, by facet, (F,); see
            `calibration`. None counts those whose name answers.
        **options: as `PolicyAgent`.
    """

    recognition: AnswerGrounding

    def __init__(
        self,
        policy: Policy,
        recognition: AnswerGrounding,
        *,
        unclear: Unclear = "guess",
        thresholds: Tensor | None = None,
        **options: Any,
    ) -> None:
        super().__init__(policy, recognition=recognition, **options)
        self.unclear = unclear
        self.thresholds = thresholds

    def recognize(self, images: Tensor) -> Tensor:
        """As `PolicyAgent.recognize`; notes which objects may answer."""
        answers = self.recognition.of_rows(self.rows)
        batches = map(self.recognition.see, images.split(BATCH), answers.split(BATCH))
        seen = SeenAnswers(*map(torch.cat, zip(*batches, strict=True)))
        self.notes = {
            "places": seen.places.numpy(),
            "candidates": seen.candidates(self.thresholds).numpy(),
        }
        return seen.frames

    @property
    def visible_answers(self) -> np.ndarray:
        """How many visible objects may answer in each environment, (n,) int64."""
        return self.notes["candidates"].sum(1)

    def act(self, observations: Mapping[str, np.ndarray]) -> np.ndarray:
        """As `PolicyAgent.act`; ``unclear`` decides who stays.

        Action 0 adds nothing to the joint targets.
        """
        actions = super().act(observations)  # counts the answers in the first image
        return np.where(self.moves[:, None], actions, 0)

    @property
    def moves(self) -> np.ndarray:
        """Whether the arm moves in each environment, (n,) bool."""
        if self.unclear == "guess":
            return np.ones(len(self.rows), np.bool_)
        count = self.visible_answers
        if self.unclear == "seen":
            return count >= 1
        return count == 1
