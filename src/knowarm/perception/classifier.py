"""Facet classifier: names the visible objects and their colours in an image."""

from collections.abc import Mapping
from typing import Any, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from knowarm.perception.config import ModuleSpec
from knowarm.perception.images import LabelledImages, query_answers
from knowarm.perception.module import (
    BATCH,
    GoalPredictor,
    PerceptionModule,
    PlaceEncoder,
    number_facets,
)
from knowarm.questions import ObjectColour
from knowarm.world.config import EnvConfig
from knowarm.world.tasks.state import EpisodeState

CONVOLUTIONS = ((3, 16, 5, 2), (16, 32, 3, 2), (32, 64, 3, 2), (64, 64, 3, 1))
"""Inputs, outputs, kernel and stride of each convolution."""


class FacetClassifier(PerceptionModule):
    """Network that scores the facets in an image; the seed is that of its initial weights."""

    FORMAT = "knowarm-perception-1"
    GOAL = ((), torch.int64)

    def __init__(self, spec: ModuleSpec, *, seed: int = 0) -> None:
        super().__init__(spec, PlaceEncoder(spec.facets, CONVOLUTIONS, seed))

    @classmethod
    def build(cls, spec: ModuleSpec, about: dict[str, Any], tensors: Mapping[str, Tensor]) -> Self:
        """As `PerceptionModule.build`."""
        return cls(spec)

    def forward(self, images: Tensor) -> Tensor:
        """Score the facets in images (n, H, W, 3) uint8: (n, F) float32, softmax over facets."""
        return self.encoder.facet_scores(self.encoder.features(images))

    def predictor(self, env: EnvConfig, facets: tuple[ObjectColour, ...]) -> GoalPredictor:
        """As `PerceptionModule.predictor`; a goal is the knowledge row of the most likely facet.

        Where the task has queries, only facets that answer the query count.
        """
        self.spec.check_fits(env, facets)
        known, device = self.spec.facets, self.encoder.facet_parts.device
        columns = torch.tensor([known.index(facet) for facet in facets], device=device)
        answers = query_answers(env, facets)
        refused = None if answers is None else ~answers.satisfies.to(device)

        def select(images: Tensor, queries: Tensor | None) -> Tensor:
            scores = self(images)[:, columns]
            if refused is not None:
                assert queries is not None
                scores = scores.masked_fill(refused[queries], -torch.inf)
            return scores.argmax(1)

        return select

    def true_goals(self, episodes: EpisodeState, ids: NDArray[np.int64]) -> Tensor:
        """As `PerceptionModule.true_goals`: the facet of the target."""
        return torch.from_numpy(episodes.facet[ids])

    def loss(self, labels: LabelledImages, rows: Tensor) -> Tensor:
        """Compute the negative log-likelihood of the visible facets, with equal shares."""
        likelihood = self(labels.images[rows]).log_softmax(dim=1)
        return -likelihood.gather(1, labels.facets[rows]).mean()


@torch.inference_mode()
def accuracy(
    classifier: FacetClassifier, labels: LabelledImages, env: EnvConfig
) -> dict[str, float]:
    """Measure how many objects in the images of a task are named correctly.

    Returns:
        Shares of the visible objects: "objects" named, "colours" named of these objects, and
        "both". Where the task has queries also "answer", the share of queries for which the most
        likely facet that answers is the target's.
    """
    scores = torch.cat([classifier(part) for part in labels.images.split(BATCH)])
    named = scores.topk(labels.facets.shape[1], dim=1).indices
    objects, colours = number_facets(classifier.spec.facets)
    # Each visible object is compared with every named facet: (N, m, m).
    same = objects[labels.facets][:, :, None] == objects[named][:, None]
    alike = colours[labels.facets][:, :, None] == colours[named][:, None]
    found, both = same.any(2), (same & alike).any(2)
    shares = {
        "objects": float(found.float().mean()),
        "colours": float(both.sum() / found.sum().clamp(min=1)),
        "both": float(both.float().mean()),
    }
    answers = query_answers(env, classifier.spec.facets)
    if answers is not None:
        chosen = scores.masked_fill(~answers.satisfies[labels.queries], -torch.inf).argmax(1)
        shares["answer"] = float((chosen == labels.facets[:, 0]).float().mean())
    return shares
