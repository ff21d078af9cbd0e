"""Link prediction: filtered ranks, MRR and Hits@k of a model."""

from collections import defaultdict
from dataclasses import dataclass

import numpy as np
import torch

from knowarm.knowledge.kge.models import KgeModel

HITS = (1, 3, 10)


@dataclass(frozen=True, kw_only=True)
class LinkPrediction:
    """Result of ranking held-out triples among all others."""

    ranks: np.ndarray
    """Filtered realistic ranks: tails of every triple, then heads, (2 n,) float64."""

    @property
    def mrr(self) -> float:
        """Mean reciprocal rank, 0 to 1."""
        return float((1.0 / self.ranks).mean()) if len(self.ranks) else float("nan")

    def hits_at(self, k: int) -> float:
        """Share of ranks at most k."""
        return float((self.ranks <= k).mean()) if len(self.ranks) else float("nan")

    def describe(self) -> dict[str, float]:
        """Return the measures as JSON-able values, for both directions together and each alone."""
        half = len(self.ranks) // 2
        tails, heads = (
            LinkPrediction(ranks=self.ranks[:half]),
            LinkPrediction(ranks=self.ranks[half:]),
        )
        values = {"mrr": self.mrr, "mrr_tails": tails.mrr, "mrr_heads": heads.mrr}
        values |= {f"hits_at_{k}": self.hits_at(k) for k in HITS}
        return values | {"mean_rank": float(self.ranks.mean()), "triples": float(half)}


@torch.no_grad()
def rank(
    model: KgeModel, triples: np.ndarray, known: np.ndarray, batch_size: int = 256
) -> LinkPrediction:
    """Rank the true tail and the true head of each triple among all entities.

    Filtered: entities that complete another known triple are skipped (Bordes et al. 2013).
    Realistic: entities with the same score share their mean rank, so that a model that scores
    all entities alike gets the middle rank:

        rank = 1 + #(higher) + #(equal, other) / 2

    Args:
        model: the model.
        triples: to rank, (n, 3) int64.
        known: every true triple, (m, 3) int64: training, validation and test.
        batch_size: queries per batch.
    """
    model.eval()
    ranks = [
        _ranks(model, queries, known_too, batch_size)
        for queries, known_too in (
            (triples, known),
            (reciprocal(triples, model.relations), reciprocal(known, model.relations)),
        )
    ]
    return LinkPrediction(ranks=np.concatenate(ranks))


def reciprocal(triples: np.ndarray, relations: int) -> np.ndarray:
    """Return (t, r + R, h) for each (h, r, t), (n, 3) int64."""
    return np.stack([triples[:, 2], triples[:, 1] + relations, triples[:, 0]], axis=1)


def _ranks(model: KgeModel, triples: np.ndarray, known: np.ndarray, batch_size: int) -> np.ndarray:
    answers: dict[tuple[int, int], list[int]] = defaultdict(list)
    asked = {(h, r) for h, r, _ in triples.tolist()}
    for h, r, t in known.tolist():
        if (h, r) in asked:
            answers[h, r].append(t)
    ranks = []
    for start in range(0, len(triples), batch_size):
        batch = torch.from_numpy(triples[start : start + batch_size])
        scores = model(batch[:, 0], batch[:, 1])
        true = scores.gather(1, batch[:, 2:])
        for row, (h, r, _) in enumerate(batch.tolist()):
            scores[row, answers[h, r]] = -torch.inf
        higher = (scores > true).sum(dim=1)
        equal = (scores == true).sum(dim=1)  # the true one itself was filtered too
        ranks.append((1.0 + higher + equal / 2.0).double().numpy())
    return np.concatenate(ranks) if ranks else np.empty(0)
