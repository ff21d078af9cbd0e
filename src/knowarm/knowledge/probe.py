"""Linear probe: which objects, colours and attributes can be recovered from embedded slots."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from knowarm.knowledge.config import KnowledgeConfig
from knowarm.knowledge.embedding import scene_embedding
from knowarm.knowledge.facets import Facet
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.queries import QueryGraph
from knowarm.knowledge.query_embedding import query_embedding
from knowarm.knowledge.scene import load_graph
from knowarm.knowledge.terms import label_of, local_name

NEARLY_SAME = 0.9
"""Cosine at which two facets count as nearly the same."""

RIDGE = 1e-2
"""Penalty of the ridge regression on slots scaled to length 1: differences much below a tenth of a
slot's length are not used."""

MOST_OTHERS = 600
"""Largest number of facets beyond the task's that a probe is fitted on; more are subsampled."""


@dataclass(frozen=True, kw_only=True)
class Probe:
    """What can be recovered from the vectors of a task."""

    slots: tuple[str, ...]
    """The task's facets."""
    cosine: np.ndarray
    """Cosine of every two facets, (S, S) float64; NaN where a slot is zero."""
    recovered: dict[str, dict[str, float]]
    """By target ("object", "colour", a relation): share recovered for the task's facets ("task")
    and for those of all objects of the graph ("all"), and by guessing the most frequent value
    ("guess"). Empty for placebos."""

    @property
    def nearly_same(self) -> list[tuple[str, str, float]]:
        """The pairs of facets that are nearly the same, and their cosine."""
        pairs = np.argwhere(np.triu(self.cosine, 1) >= NEARLY_SAME)
        return [(self.slots[i], self.slots[j], float(self.cosine[i, j])) for i, j in pairs]

    @property
    def largest(self) -> float:
        """The largest cosine of two different facets."""
        upper = self.cosine[np.triu_indices(len(self.slots), 1)]
        return float(np.nanmax(upper)) if np.isfinite(upper).any() else float("nan")

    def describe(self) -> dict[str, Any]:
        """Return everything as JSON-able values."""
        cosine = [[None if np.isnan(x) else float(x) for x in row] for row in self.cosine]
        largest = None if np.isnan(self.largest) else self.largest
        return {
            "slots": list(self.slots),
            "cosine": cosine,
            "largest_cosine": largest,
            "nearly_same": [list(pair) for pair in self.nearly_same],
            "recovered": self.recovered,
        }


def probe(config: KnowledgeConfig, facets: Sequence[tuple[str, str]]) -> Probe:
    """Fit linear probes to the slots of an embedding.

    Every object of the graph that has a colour is embedded by the same config, one slot per
    colour. A ridge regression to one-hot targets is fitted on all slots but one and predicts
    object and colour of that one. For attributes, all slots of an object are held out, and the
    prediction is the k values with the highest scores, where k values are true.

    Args:
        config: the embedding.
        facets: the task's (object, colour) pairs.
    """
    task = scene_embedding(config, facets)
    cosine = _cosine(task.matrix)
    names = tuple(slot.name for slot in task.slots)
    if config.source.placebo or config.detail == "none":
        return Probe(slots=names, cosine=cosine, recovered={})
    graph = load_graph(config)
    pairs = _population(graph, facets, config)
    everything = scene_embedding(config, pairs)
    vectors = everything.matrix.astype(np.float64)
    vectors /= np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)
    slots = [slot for slot in everything.slots if isinstance(slot, Facet)]
    in_task = np.array([slot in task.slots for slot in slots])
    objects = np.array([slot.object for slot in slots])
    recovered: dict[str, dict[str, float]] = {}
    if config.detail == "full":
        named = [config.entity_names.get(slot.colour or "", slot.colour or "") for slot in slots]
        colours = np.array([label_of(name, graph.labels) for name in named])
        for asked, answers in (("object", objects), ("colour", colours)):
            scores = _single(vectors, answers, in_task)
            if scores:
                recovered[asked] = scores
    recovered |= _attributes(graph, vectors, objects, in_task, config)
    return Probe(slots=names, cosine=cosine, recovered=recovered)


def _cosine(matrix: np.ndarray) -> np.ndarray:
    wide = matrix.astype(np.float64)
    length = np.linalg.norm(wide, axis=1, keepdims=True)
    unit = np.divide(wide, length, out=np.full_like(wide, np.nan), where=length > 0)
    return unit @ unit.T


def _population(
    graph: KnowledgeGraph, facets: Sequence[tuple[str, str]], config: KnowledgeConfig
) -> list[tuple[str, str]]:
    """Return the task's facets, then those of all other objects that have a colour."""
    rows = np.flatnonzero(graph.relations == graph.relation_id(config.colour_relation))
    known = {graph.entity_id(config.entity_names.get(name, name)) for name, _ in facets}
    others = [
        (graph.names[graph.heads[row]], graph.names[graph.tails[row]])
        for row in rows
        if int(graph.heads[row]) not in known
    ]
    if len(others) > MOST_OTHERS:
        drawn = np.random.default_rng(config.seed).choice(len(others), MOST_OTHERS, replace=False)
        others = [others[i] for i in np.sort(drawn)]
    return [*facets, *others]


def _predict(vectors: np.ndarray, targets: np.ndarray, held: np.ndarray) -> np.ndarray:
    """Fit ridge regression without the held rows; return scores for them, (h, classes)."""
    train = ~held
    mean, centre = vectors[train].mean(axis=0), targets[train].mean(axis=0)
    x, y = vectors[train] - mean, targets[train] - centre
    gram = x @ x.T + RIDGE * np.eye(len(x))
    return (vectors[held] - mean) @ x.T @ np.linalg.solve(gram, y) + centre


def _single(vectors: np.ndarray, answers: np.ndarray, in_task: np.ndarray) -> dict[str, float]:
    """Predict one answer per slot, leaving one slot out; answers that occur once are skipped."""
    classes, index, counts = np.unique(answers, return_inverse=True, return_counts=True)
    targets = np.eye(len(classes))[index]
    rows = np.flatnonzero(counts[index] > 1)
    right = {}
    for row in rows:
        held = np.zeros(len(vectors), bool)
        held[row] = True
        right[int(row)] = int(_predict(vectors, targets, held)[0].argmax()) == index[row]
    in_rows = [right[int(row)] for row in rows if in_task[row]]
    if not in_rows:
        return {}
    return {
        "task": float(np.mean(in_rows)),
        "all": float(np.mean(list(right.values()))),
        "guess": float(counts.max() / len(answers)),
    }


def _attributes(
    graph: KnowledgeGraph,
    vectors: np.ndarray,
    objects: np.ndarray,
    in_task: np.ndarray,
    config: KnowledgeConfig,
) -> dict[str, dict[str, float]]:
    """Predict the values of each relation, leaving out all slots of one object at a time."""
    colour = graph.relation_id(config.colour_relation)
    ids = np.array([graph.entity_id(config.entity_names.get(name, name)) for name in objects])
    scores = {}
    for relation in np.unique(graph.relations[np.isin(graph.heads, ids)]):
        rows = np.flatnonzero((graph.relations == relation) & np.isin(graph.heads, ids))
        tails, place, counts = np.unique(graph.tails[rows], return_inverse=True, return_counts=True)
        if relation == colour or (counts > 1).sum() < 2:
            continue
        true = np.zeros((len(objects), len(tails)))
        for row, column in zip(rows, place, strict=True):
            true[ids == graph.heads[row], column] = 1.0
        true = true[:, counts > 1]  # a value of a single object cannot be learned from others
        asked = true.sum(axis=1) > 0
        found = np.full(len(objects), np.nan)
        guess = np.full(len(objects), np.nan)
        for name in np.unique(objects[asked]):
            held = objects == name
            predicted = _predict(vectors, true, held)
            frequent = true[~held].mean(axis=0)
            for row, score in zip(np.flatnonzero(held), predicted, strict=True):
                found[row] = _share_found(score, true[row])
                guess[row] = _share_found(frequent, true[row])
        if asked[in_task].any():
            scores[local_name(graph.relation_names[int(relation)])] = {
                "task": float(np.nanmean(found[in_task])),
                "all": float(np.nanmean(found)),
                "guess": float(np.nanmean(guess)),
            }
    return scores


def _share_found(scores: np.ndarray, true: np.ndarray) -> float:
    """Return the share of the k true values that are among the k highest scores."""
    k = int(true.sum())
    best = np.argsort(-scores, kind="stable")[:k]
    return float(true[best].sum() / k)


def query_agreement(
    config: KnowledgeConfig, asked: QueryGraph, *, run_seed: int = 0
) -> float | None:
    """Measure whether conditions with similar answers have similar slots.

    Args:
        config: knowledge of scope "query"; its graph is that of ``asked``.
        asked: the graph with the facets of a task.
        run_seed: seed of the training run, for placebos that are drawn.

    Returns:
        Spearman's rank correlation, over all pairs of facts that can be asked, of the cosine of
        their slots and the share of objects that satisfy both among those that satisfy either.
        None if all slots are equally similar, as one-hot codes are.
    """
    facts = [query for query in asked.queries("none") if not query.conditions[0].is_colour]
    texts = [query.name for query in facts]
    cosine = _cosine(query_embedding(config, texts, run_seed=run_seed, graph=asked.graph).matrix)
    owner = np.array([asked.objects.index(name) for name, _ in asked.facets])
    holds = np.array(
        [np.bincount(owner[row], minlength=len(asked.objects)) > 0 for row in asked.answers(facts)]
    )
    both = (holds[:, None] & holds).sum(2)
    either = (holds[:, None] | holds).sum(2)
    pairs = np.triu_indices(len(facts), 1)
    if not len(pairs[0]) or np.ptp(cosine[pairs]) < 1e-6:
        return None
    return float(scipy.stats.spearmanr(cosine[pairs], (both / either)[pairs]).statistic)
