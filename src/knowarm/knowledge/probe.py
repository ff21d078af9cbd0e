"""Linear probe: which objects, colours and attributes can be recovered from embedded slots."""

from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter, itemgetter
from typing import Any

import numpy as np
import scipy
from numpy.linalg import norm

from knowarm.arrays import Integers, Mask, Names
from knowarm.knowledge.config import KnowledgeConfig
from knowarm.knowledge.embedding import SceneEmbedding, query_embedding, scene_embedding
from knowarm.knowledge.formats import read_graph
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.terms import label_of, local_name
from knowarm.knowledge.queries.queries import QueryGraph
from knowarm.knowledge.vectors.source import Vectors

NEARLY_SAME = 0.9
"""Cosine at which two facets count as nearly the same."""
RIDGE = 1e-2
"""Penalty of the ridge regression on slots scaled to length 1: differences much below a tenth of a
slot's length are not used."""
MOST_OTHERS = 600
"""Largest number of facets beyond the task's that a probe is fitted on; more are subsampled."""


Facet = tuple[str, str]
"""Object and colour."""
Scores = dict[str, float]
"""Shares of a target that are recovered."""
Recovered = dict[str, Scores]
"""Scores by target."""


@dataclass(frozen=True, kw_only=True)
class Probe:
    """What can be recovered from the vectors of a task."""

    slots: tuple[str, ...]
    """The task's facets."""
    cosine: Vectors
    """Cosine of every two facets, (S, S) float64; NaN where a slot is zero."""
    recovered: Recovered
    """By target ("object", "colour", a relation): share recovered for the task's facets ("task")
    and for those of all objects of the graph ("all"), and by guessing the most frequent value
    ("guess"). Empty for placebos."""

    @property
    def nearly_same(self) -> list[tuple[str, str, float]]:
        """The pairs of facets that are nearly the same, and their cosine."""
        pairs = np.argwhere(np.triu(self.cosine, 1) >= NEARLY_SAME)
        cosine = self.cosine.tolist()
        return [(self.slots[i], self.slots[j], cosine[i][j]) for i, j in pairs]

    @property
    def largest(self) -> float:
        """The largest cosine of two different facets."""
        upper = self.cosine[np.triu_indices(len(self.slots), 1)]
        if not np.isfinite(upper).any():
            return float("nan")
        return float(np.nanmax(upper))

    def describe(self) -> dict[str, Any]:
        """Return everything as JSON-able values."""
        cosine = self.cosine.astype(object)
        cosine[np.isnan(self.cosine)] = None
        return {
            "slots": list(self.slots),
            "cosine": cosine.tolist(),
            "largest_cosine": None if np.isnan(self.largest) else self.largest,
            "nearly_same": list(map(list, self.nearly_same)),
            "recovered": self.recovered,
        }


def probe(
    config: KnowledgeConfig, facets: Sequence[Facet], *, run_seed: int = 0
) -> Probe:
    """Fit linear probes to the slots of an embedding of the task's (object, colour) pairs.

    Every object of the graph that has a colour is embedded by the same config, one slot per
    colour. A ridge regression to one-hot targets is fitted on all slots but one and predicts
    object and colour of that one. For attributes, all slots of an object are held out, and the
    prediction is the k values with the highest scores, where k values are true.
    """
    task = scene_embedding(config, facets, run_seed=run_seed)
    recovered = Recovered()
    if not config.source.placebo:
        graph = read_graph(config.graph)
        population = scene_embedding(config, _population(graph, facets, config))
        for target, scores in _recovered(graph, population, task).items():
            if scores:
                recovered[target] = scores
    return Probe(
        slots=tuple(map(attrgetter("name"), task.slots)),
        cosine=_cosine(task.matrix),
        recovered=recovered,
    )


def _recovered(
    graph: KnowledgeGraph, population: SceneEmbedding, task: SceneEmbedding
) -> Recovered:
    """Return the shares recovered by target, {} for a target without any of the task."""
    config = population.config
    vectors = population.matrix.astype(np.float64)
    lengths = norm(vectors, axis=1, keepdims=True)
    vectors /= np.maximum(lengths, 1e-12)
    in_task = np.array([slot in task.slots for slot in population.slots])
    objects = np.array([slot.object for slot in population.slots])
    recovered = Recovered()
    if config.detail == "full":
        colours = list[str]()
        for slot in population.slots:
            colours.append(label_of(config.graph_name(slot.colour or ""), graph.labels))
        recovered["object"] = _single(vectors, objects, in_task)
        recovered["colour"] = _single(vectors, np.array(colours), in_task)
    return recovered | _attributes(graph, vectors, objects, in_task, config)


def _cosine(matrix: Vectors) -> Vectors:
    wide = matrix.astype(np.float64)
    length = norm(wide, axis=1, keepdims=True)
    unit = np.divide(wide, length, out=np.full_like(wide, np.nan), where=length > 0)
    return unit @ unit.T


def _population(
    graph: KnowledgeGraph, facets: Sequence[Facet], config: KnowledgeConfig
) -> list[Facet]:
    """Return the task's facets, then those of all other objects that have a colour."""
    names = [config.graph_name(name) for name, _ in facets]
    task_objects = list(map(graph.entity_id, names))
    coloured = graph.relations == graph.relation_id(config.colour_relation)
    is_other = ~np.isin(graph.heads, task_objects)
    rows = np.flatnonzero(coloured & is_other)
    if len(rows) > MOST_OTHERS:
        rng = np.random.default_rng(config.seed)
        rows = rng.choice(rows, MOST_OTHERS, replace=False)
    others = graph.rows(np.sort(rows))
    return [*facets, *map(itemgetter(0, 2), others)]


def _predict(vectors: Vectors, targets: Vectors, held: Mask) -> Vectors:
    """Fit ridge regression without the held rows; return scores for them, (h, classes)."""
    train = ~held
    mean = vectors[train].mean(axis=0)
    centre = targets[train].mean(axis=0)
    x = vectors[train] - mean
    gram = x @ x.T + RIDGE * np.eye(len(x))
    weights = np.linalg.solve(gram, targets[train] - centre)
    asked = vectors[held] - mean
    return asked @ x.T @ weights + centre


def _leave_out(
    vectors: Vectors, true: Vectors, groups: Names | Integers, asked: Mask
) -> tuple[Vectors, Vectors]:
    """Predict the values of the slots of each group without it, if some of it are asked, (S,).

    Returns:
        The shares of the true values that are predicted, and those that are guessed by how
        frequent values are; NaN where no value was predicted, (S,).
    """
    shares = np.full((2, len(groups)), np.nan)
    for group in np.unique(groups[asked]):
        held = groups == group
        frequent = true[~held].mean(axis=0)
        predicted = _predict(vectors, true, held)
        for row, scores in zip(np.flatnonzero(held), predicted, strict=True):
            shares[0, row] = _share_found(scores, true[row])
            shares[1, row] = _share_found(frequent, true[row])
    return shares[0], shares[1]


def _scores(shares: Vectors, guess: Vectors, in_task: Mask) -> Scores:
    """Average what was asked of each slot, (S,); NaN where nothing was, {} if not of the task."""
    if np.isnan(shares[in_task]).all():
        return {}
    return {
        "task": float(np.nanmean(shares[in_task])),
        "all": float(np.nanmean(shares)),
        "guess": float(np.nanmean(guess)),
    }


def _single(vectors: Vectors, answers: Names, in_task: Mask) -> Scores:
    """Predict one answer per slot, leaving one slot out; answers that occur once are skipped."""
    classes, index, counts = np.unique(answers, return_inverse=True, return_counts=True)
    true = np.eye(len(classes))[index]
    slots = np.arange(len(answers))
    hits, _ = _leave_out(vectors, true, slots, counts[index] > 1)
    most_frequent = counts.max(keepdims=True) / len(answers)
    return _scores(hits, most_frequent, in_task)


def _attributes(
    graph: KnowledgeGraph,
    vectors: Vectors,
    objects: Names,
    in_task: Mask,
    config: KnowledgeConfig,
) -> Recovered:
    """Predict the values of each relation, leaving out all slots of one object at a time."""
    colour = graph.relation_id(config.colour_relation)
    names = map(config.graph_name, objects)
    ids = np.array(list(map(graph.entity_id, names)))
    about = np.isin(graph.heads, ids)
    scores = Recovered()
    for relation in np.unique(graph.relations[about]):
        rows = np.flatnonzero((graph.relations == relation) & about)
        tails, columns = np.unique(graph.tails[rows], return_inverse=True)
        counts = np.bincount(columns)
        if relation == colour:
            continue
        # A value of a single object cannot be learned from others.
        is_shared = counts > 1
        if is_shared.sum() < 2:
            continue
        values = np.eye(len(tails))[:, is_shared]
        is_stated = ids[:, None] == graph.heads[rows]
        true = is_stated @ values[columns]
        shares, guess = _leave_out(vectors, true, objects, true.any(axis=1))
        name = local_name(graph.relation_names[relation])
        scores[name] = _scores(shares, guess, in_task)
    return scores


def _share_found(scores: Vectors, true: Vectors) -> float:
    """Return the share of the k true values that are among the k highest scores."""
    k = int(true.sum())
    highest = np.argsort(-scores, kind="stable")[:k]
    return float(true[highest].mean())


def query_agreement(
    config: KnowledgeConfig, asked: QueryGraph, *, run_seed: int = 0
) -> float | None:
    """Return Spearman's rank correlation of similar answers and similar slots of conditions.

    Over all pairs of facts, it compares the cosine of their slots with the share of objects that
    satisfy both among those that satisfy either. None if all slots are equally similar.
    """
    queries = asked.queries("none")
    facts = [query for query in queries if not query.conditions[0].is_seen]
    embedding = query_embedding(config, facts, run_seed=run_seed, graph=asked.graph)
    cosine = _cosine(embedding.matrix)
    is_of = asked.owner == np.arange(len(asked.objects))[:, None]
    answers = asked.answers(facts) @ is_of.T
    both = (answers[:, None] & answers).sum(2)
    either = (answers[:, None] | answers).sum(2)
    pairs = np.triu_indices(len(facts), 1)
    cosines = cosine[pairs]
    if not len(cosines):
        return None
    if not np.ptp(cosines) >= 1e-6:  # NaN for slots of zeros
        return None
    overlap = both / either
    correlation = scipy.stats.spearmanr(cosines, overlap[pairs])
    return float(correlation.statistic)
