"""Random splits of a graph into training, validation and test triples."""

from typing import NamedTuple

import numpy as np

from knowarm.errors import UserError
from knowarm.knowledge.graph.graph import KnowledgeGraph


class Split(NamedTuple):
    """Triples in three disjoint parts, as ids (n, 3) int64: head, relation, tail."""

    graph: KnowledgeGraph
    """The whole graph; ids point into its names."""
    train: np.ndarray
    valid: np.ndarray
    test: np.ndarray

    @property
    def entities(self) -> int:
        """Number of entities."""
        return len(self.graph.names)

    @property
    def relations(self) -> int:
        """Number of relations."""
        return len(self.graph.relation_names)

    @property
    def everything(self) -> np.ndarray:
        """All triples, (n, 3) int64."""
        return np.concatenate([self.train, self.valid, self.test])


def all_triples(graph: KnowledgeGraph) -> np.ndarray:
    """Return a graph's triples as ids (n, 3) int64."""
    return np.stack([graph.heads, graph.relations, graph.tails], axis=1).astype(np.int64)


def split_graph(
    graph: KnowledgeGraph, *, valid: float = 0.1, test: float = 0.1, seed: int = 0
) -> Split:
    """Split a graph at random so that every entity and relation occurs in training.

    Triples are taken in a random order; one is held out only while training keeps another triple
    of its head, relation and tail. `valid` and `test` are the shares to hold out.
    """
    if not (0 <= valid < 1 and 0 < test < 1 and valid + test < 1):
        raise UserError(
            f"Shares to hold out are valid={valid} and test={test}; each must lie between 0 and 1 "
            f"and both together below 1."
        )
    triples = all_triples(graph)
    wanted = [round(share * len(triples)) for share in (test, valid)]
    ends = np.bincount(triples[:, [0, 2]].ravel(), minlength=len(graph.names))
    uses = np.bincount(triples[:, 1], minlength=len(graph.relation_names))
    held: list[int] = []
    for row in np.random.default_rng(seed).permutation(len(triples)):
        if len(held) == sum(wanted):
            break
        head, relation, tail = triples[row]
        if min(ends[head], ends[tail]) > 1 + (head == tail) and uses[relation] > 1:
            ends[head] -= 1
            ends[tail] -= 1
            uses[relation] -= 1
            held.append(int(row))
    if not held:
        raise UserError(
            f"No triple of {len(triples)} can be held out so that every entity stays in training. "
            f"Give a larger graph, or a folder with train2id.txt and test2id.txt."
        )
    testing = held[: max(1, round(len(held) * test / (test + valid)))]
    validating = held[len(testing) :]
    keep = np.ones(len(triples), bool)
    keep[held] = False
    return Split(graph=graph, train=triples[keep], valid=triples[validating], test=triples[testing])
