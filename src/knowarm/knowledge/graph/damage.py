"""Damaged graphs: triples that are missing, wrong or swapped, by share."""

from collections.abc import Collection
from typing import Literal, get_args

import numpy as np

from knowarm.errors import UserError, unknown_name
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.seeding import seed_sequence

Damage = Literal["missing", "wrong", "adversarial"]
"""Kinds of damage:

- ``missing``: triples are removed;
- ``wrong``: triples get another tail of the same relation, with which they state something new;
- ``adversarial``: values of one relation are swapped in pairs, so that all that answered one
  answers the other, and the reverse.
"""


def damaged(
    graph: KnowledgeGraph, kind: Damage, share: float, seed: int, objects: Collection[str]
) -> KnowledgeGraph:
    """Damage a share of the triples about some objects; all entities and other triples stay.

    What a smaller share damages, a larger one damages as well. The share of "wrong" is
    reached as far as there are other tails, and that of "adversarial" up to the triples of one pair
    of values, or as far as there are pairs.

    Raises:
        UserError: an unknown kind, or a share outside 0 to 1.
    """
    if kind not in get_args(Damage):
        raise unknown_name("kind of damage", kind, get_args(Damage))
    if not 0 <= share <= 1:
        raise UserError(f"The share of damaged triples must lie between 0 and 1, got {share}.")
    rng = np.random.default_rng(seed_sequence(seed, "damage", get_args(Damage).index(kind)))
    triples = graph.triples
    about = np.flatnonzero(np.isin(graph.heads, [graph.entity_id(name) for name in objects]))
    count, order = round(share * len(about)), rng.permutation(about)
    if kind == "missing":
        keep = np.setdiff1d(np.arange(len(triples)), order[:count])
        return graph.rows(keep, nodes=graph.nodes)
    if kind == "wrong":
        stated = set(map(tuple, triples.tolist()))
        for row in order:  # all are drawn, so that every share draws the same
            head, relation, _ = triples[row].tolist()
            tails = np.unique(graph.tails[about][graph.relations[about] == relation])
            new = [t for t in rng.permutation(tails).tolist() if (head, relation, t) not in stated]
            if new and count > 0:
                triples[row, 2], count = new[0], count - 1
                stated.add((head, relation, new[0]))
    else:
        triples[:, 2] = _swapped(graph, rng, about, count)
    return graph.with_triples(triples)


def _swapped(
    graph: KnowledgeGraph, rng: np.random.Generator, about: np.ndarray, count: int
) -> np.ndarray:
    """Swap values of one relation in pairs until ``count`` of some rows have another tail."""
    pairs, relations, tails = [], graph.relations[about], graph.tails.copy()
    for relation in np.unique(relations):
        values = rng.permutation(np.unique(tails[about][relations == relation]))
        pairs += [(relation, *values[i : i + 2]) for i in range(0, len(values) - 1, 2)]
    for number in rng.permutation(len(pairs)):
        relation, one, other = pairs[number]
        rows = [
            about[(relations == relation) & (graph.tails[about] == value)] for value in (one, other)
        ]
        if count <= 0:
            break
        tails[rows[0]], tails[rows[1]] = other, one
        count -= sum(map(len, rows))
    return tails
