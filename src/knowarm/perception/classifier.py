"""Facet classifier: names the visible objects and their colours in an image."""

from collections.abc import Mapping
from typing import Any, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from knowarm.perception.agent import Recognition
from knowarm.perception.config import ModuleSpec
from knowarm.perception.images import LabelledImages, query_answers
from knowarm.perception.module import BATCH, PerceptionModule, PlaceEncoder, number_facets
from knowarm.world.config import EnvConfig, facets_of
from knowarm.world.tasks.state import EpisodeState

CONVOLUTIONS = ((3, 16, 5, 2), (16, 32, 3, 2), (32, 64, 3, 2), (64, 64, 3, 1))
"""Inputs, outputs, kernel and stride of each convolution."""


class FacetClassifier(PerceptionModule):
    """Network that scores the facets in an image; the seed is that of its initial weights."""

    FORMAT = "knowarm-perception-1"

    def __init__(self, spec: ModuleSpec, *, seed: int = 0) -> None:
        super().__init__(spec, PlaceEncoder(spec.facets, CONVOLUTIONS, seed))

    @classmethod
    def build(cls, spec: ModuleSpec, about: dict[str, Any], tensors: Mapping[str, Tensor]) -> Self:
        """As `PerceptionModule.build`."""
        return cls(spec)

    def forward(self, images: Tensor) -> Tensor:
        """Score the facets in images (n, H, W, 3) uint8: (n, F) float32, softmax over facets."""
        return self.encoder.facet_scores(self.encoder.features(images))

    def loss(self, labels: LabelledImages, rows: Tensor) -> Tensor:
        """Compute the negative log-likelihood of the visible facets, with equal shares."""
        likelihood = self(labels.images[rows]).log_softmax(dim=1)
        return -likelihood.gather(1, labels.facets[rows]).mean()


class NamedFacet(Recognition):
    """Recognition of the most likely facet: the policy receives its row of a table.

    Where the task has queries, only facets that answer the query count, so that ``knowledge`` is
    1 for facets that answer each query and 0 for others.

    Args:
        classifier: names the facets.
        env: the task.
        table: (F, K) float32, one row per facet of the task.
    """

    columns: Tensor
    table: Tensor

    def __init__(self, classifier: FacetClassifier, env: EnvConfig, table: np.ndarray) -> None:
        facets = facets_of(env)
        classifier.spec.check_fits(env, facets)
        answers = query_answers(env, facets)
        allowed = torch.ones(1, len(facets)) if answers is None else answers.satisfies
        super().__init__(classifier, allowed, table.shape[1])
        columns = [classifier.spec.facets.index(facet) for facet in facets]
        self.register_buffer("columns", torch.tensor(columns))
        self.register_buffer("table", torch.as_tensor(table))

    def check_fits(self, env: EnvConfig) -> None:
        """As `Recognition.check_fits`."""
        self.module.spec.check_fits(env, facets_of(env))

    def locate(self, images: Tensor, knowledge: Tensor) -> Tensor:
        """As `Recognition.locate`."""
        scores = self.module(images)[:, self.columns]
        return self.table[scores.masked_fill(knowledge == 0, -torch.inf).argmax(1)]

    def true_knowledge(self, episodes: EpisodeState, ids: NDArray[np.int64]) -> Tensor:
        """As `Recognition.true_knowledge`: the row of the target's facet."""
        return self.table[torch.from_numpy(episodes.facet[ids]).to(self.table.device)]


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
