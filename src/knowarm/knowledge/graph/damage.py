"""Damaged graphs: triples that are missing, wrong or swapped, by share."""

from collections.abc import Collection
from typing import Literal, get_args

import numpy as np
from numpy.random import Generator

from knowarm.errors import UserError, unknown_name
from knowarm.knowledge.graph.graph import Ids, KnowledgeGraph
from knowarm.seeding import seed_sequence

Damage = Literal["missing", "wrong", "adversarial"]
"""Kinds of damage:

- ``missing``: triples are removed;
- ``wrong``: triples get another tail of the same relation, with which they state something new;
- ``adversarial``: values of one relation are swapped in pairs, so that all that answered one
  answers the other, and the reverse.
"""


def damaged(
    graph: KnowledgeGraph,
    kind: Damage,
    share: float,
    seed: int,
    objects: Collection[str],
) -> KnowledgeGraph:
    """Damage a share of the triples about some objects; all entities and other triples stay.

    What a smaller share damages, a larger one damages as well. The share of "wrong" is
    reached as far as there are other tails, and that of "adversarial" up to the triples of one pair
    of values, or as far as there are pairs.

    Raises:
        UserError: an unknown kind, or a share outside 0 to 1.
    """
    kinds = get_args(Damage)
    if kind not in kinds:
        raise unknown_name("kind of damage", kind, kinds)
    if not 0 <= share <= 1:
        raise UserError(
            f"The share of damaged triples must lie between 0 and 1, got {share}."
        )
    rng = np.random.default_rng(seed_sequence(seed, "damage", kinds.index(kind)))
    ids = list(map(graph.entity_id, objects))
    about = np.flatnonzero(np.isin(graph.heads, ids))
    order = rng.permutation(about)
    count = round(share * len(about))
    if kind == "missing":
        kept = np.setdiff1d(np.arange(len(graph)), order[:count])
        return graph.rows(kept, nodes=graph.nodes)
    if kind == "wrong":
        return graph.with_triples(_wrong(graph, rng, about, order, count))
    return graph.with_triples(_swapped(graph, rng, about, count))


def _wrong(
    graph: KnowledgeGraph, rng: Generator, about: Ids, order: Ids, count: int
) -> Ids:
    """Return the triples, of which up to ``count`` get another tail, in an order of rows."""
    triples = graph.triples
    stated = set(map(tuple, triples.tolist()))
    for row in order:  # all are drawn, so that every share draws the same
        head, relation, _ = triples[row].tolist()
        candidates = np.unique(graph.tails[about][graph.relations[about] == relation])
        for tail in rng.permutation(candidates).tolist():
            if count > 0 and (head, relation, tail) not in stated:
                stated.add((head, relation, tail))
                triples[row, 2] = tail
                count -= 1
                break
    return triples


def _swapped(graph: KnowledgeGraph, rng: Generator, about: Ids, count: int) -> Ids:
    """Return the triples with swapped pairs of values, until ``count`` have another tail."""
    triples = graph.triples
    relations = graph.relations[about]
    tails = graph.tails[about]
    pairs = []
    for relation in np.unique(relations):
        values = rng.permutation(np.unique(tails[relations == relation]))
        for first, second in zip(values[::2], values[1::2], strict=False):
            pairs.append((relation, first, second))
    for number in rng.permutation(len(pairs)):
        if count <= 0:
            break
        relation, first, second = pairs[number]
        with_first = about[(relations == relation) & (tails == first)]
        with_second = about[(relations == relation) & (tails == second)]
        triples[with_first, 2] = second
        triples[with_second, 2] = first
        count -= len(with_first) + len(with_second)
    return triples
