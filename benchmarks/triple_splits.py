"""Splits of a graph's triples into three parts, for link prediction."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from knowarm.errors import UserError
from knowarm.knowledge.formats.splits import PARTS, read_parts
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.kge.train import held_out_rows


class Split(NamedTuple):
    """Triples in three disjoint parts, as ids (n, 3) int64: head, relation, tail."""

    graph: KnowledgeGraph
    """The whole graph; ids point into its names."""
    train: np.ndarray
    valid: np.ndarray
    test: np.ndarray

    @property
    def entities(self) -> int:
        return len(self.graph.names)

    @property
    def relations(self) -> int:
        return len(self.graph.relation_names)

    @property
    def everything(self) -> np.ndarray:
        """All triples, (n, 3) int64."""
        return np.concatenate([self.train, self.valid, self.test])


def split_graph(
    graph: KnowledgeGraph, *, valid: float = 0.1, test: float = 0.1, seed: int = 0
) -> Split:
    """Hold out shares of the triples at random; every entity and relation occurs in training."""
    triples = graph.triples
    count = round(test * len(triples)) + round(valid * len(triples))
    held = held_out_rows(graph, count, seed)
    testing = held[: max(1, round(len(held) * test / (test + valid)))]
    validating = held[len(testing) :]
    return Split(
        graph=graph,
        train=np.delete(triples, held, axis=0),
        valid=triples[validating],
        test=triples[testing],
    )


def read_split(folder: Path) -> Split:
    """Read the triples of a folder as they are split; no triple may be in several parts."""
    graph, triples = read_parts(folder)
    parts = {}
    for name, part in triples.items():
        ids = []
        for head, relation, tail in part:
            ends = graph.names.find_all([head, tail])
            ids.append([ends[0], *graph.relation_names.find_all([relation]), ends[1]])
        parts[name] = np.array(ids, np.int64).reshape(-1, 3)
    distinct = [np.unique(part, axis=0) for part in parts.values()]
    rows, counts = np.unique(np.concatenate(distinct), axis=0, return_counts=True)
    for head, relation, tail in rows[counts > 1][:1]:
        triple = (
            f"{graph.names[head]} {graph.relation_names[relation]} {graph.names[tail]}"
        )
        raise UserError(
            f"{folder}: the triple {triple} is in several of {', '.join(PARTS)}, so that a test "
            "would not be one. Leave it in one."
        )
    return Split(graph=graph, **parts)
