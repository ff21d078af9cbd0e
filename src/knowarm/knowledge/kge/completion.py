"""Completion of a graph by link prediction: likely triples about some objects are added."""

from collections.abc import Collection
from itertools import product

import numpy as np
import torch

from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.kge import KgeConfig
from knowarm.knowledge.kge.train import both_ways, hold_out, train

HELD_OUT = 0.2
"""Share of the triples that decide which score is high enough."""


def completed(
    graph: KnowledgeGraph, objects: Collection[str], *, model: str, seed: int = 0
) -> KnowledgeGraph:
    """Add the triples (object, relation, value) whose scores by a graph embedding are high enough.

    The model is trained on a part of the graph. High enough is the score at which telling the
    triples of the other part from those that the graph does not state has the largest F1, as in
    triple classification (Socher et al. 2013). Values are those that some object has.

    Args:
        graph: what is known.
        objects: names of the objects that facts are added about.
        model: key of `kge.models.MODELS`.
        seed: of the split, the initial vectors and the order of triples.

    Raises:
        UserError: an unknown model, or too few triples to hold any out.
    """
    kept, held_out = hold_out(graph, HELD_OUT, seed)
    relations = len(graph.relation_names)
    config = KgeConfig(model=model, seed=seed)
    with torch.enable_grad():  # whatever the caller measures
        fitted = train(config, kept, len(graph.names), relations, valid=held_out)
    ids = sorted(map(graph.entity_id, objects))
    about = np.isin(graph.heads, ids)
    pairs = np.unique(graph.triples[about, 1:], axis=0)
    trained_on = set(map(tuple, kept.tolist()))
    candidates = list[tuple[int, ...]]()
    for head, pair in product(ids, pairs.tolist()):
        candidate = (head, *pair)
        if candidate not in trained_on:
            candidates.append(candidate)
    if not candidates:
        return graph
    triples = np.array(candidates)
    asked = torch.from_numpy(both_ways(triples, relations))
    with torch.no_grad():
        all_scores = fitted.model(asked[:, 0], asked[:, 1])
    as_tails, as_heads = all_scores.gather(1, asked[:, 2:]).chunk(2)
    scores = (as_tails + as_heads)[:, 0]
    order = (-scores).argsort(stable=True).numpy()
    held = set(map(tuple, held_out.tolist()))
    hits = np.cumsum([candidates[index] in held for index in order])
    if hits[-1] == 0:
        return graph
    chosen = np.arange(1, len(order) + 1)
    half_f1 = hits / (chosen + hits[-1])
    best = half_f1.argmax()
    added = triples[order[: best + 1]]
    return graph.with_triples(np.concatenate([graph.triples, added]))
